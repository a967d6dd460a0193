"""A study run: what is not done yet, by processes here or workers of a cluster, into its folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from orchestrator.batch.sweep.runs import folder as folders
from orchestrator.batch.sweep.runs import rows
from orchestrator.batch.sweep.runs.cluster import Cluster
from orchestrator.batch.sweep.runs.folder import Folder
from orchestrator.batch.sweep.runs.local import Local
from orchestrator.batch.sweep.runs.preparation import PreparedSweep, prepared
from orchestrator.batch.sweep.runs.queue import Queue, Runner
from orchestrator.batch.sweep.runs.same import SamePoints
from orchestrator.batch.sweep.told.report import PAGE, report
from orchestrator.batch.sweep.told.result import SweepResult
from orchestrator.batch.sweep.told.summary import write_summary
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent


def sweep(
    study: str | Path,
    out: str | Path | None = None,
    by: Runner | int | str | None = None,
    progress: Progress = silent,
    retry: bool = False,
    isolation: Isolation | None = None,
) -> SweepResult:
    """The data set in the folder `out`, once a study has been run at all points that have no row there yet.

    Args:
        out: by default `out/` and the name of the study.
        by: who runs them: so many processes of this machine, by default one a processor; or the Dask cluster with this
            address of its scheduler, as `tcp://HOST:8786`.
        retry: whether runs that failed are run again.
        isolation: of FMUs given as files; a run in which one crashes or hangs has failed.

    Raises:
        ScenarioError: the study does not fit itself or its scenario.
        InputError: the folder is another study's, or the disk is full; what was done stays.
        ServotwinError: what loading and building the scenario raises.
    """
    who, path = _runner(by), Path(out or Path("out", Path(study).stem))
    who.check()
    with prepared(Path(study)) as ready:
        size = folders.part_rows(_samples(ready))
        same = SamePoints(ready.setup, ready.design)
        with folders.opened(path, ready.runs, size, ready.identity, [ready.file], same) as folder:
            if retry:
                folder.retry()
            setup = replace(ready.setup, isolation=isolation)
            queue = Queue(setup, ready.design, folder)
            for task, done in who.outcomes(queue, setup) if folder.left else ():
                folder.keep(task.runs, rows.unpacked(done.rows), done)
                progress(*_how_far(folder))
            result = write_summary(ready, path)
            report(ready, result).write(result.folder / PAGE)
            return result


def _how_far(folder: Folder) -> tuple[float, str]:
    done, count = int(folder.done.sum()), len(folder.done)
    failed = f", {folder.failed:,} failed" if folder.failed else ""
    return done / count, f"{done:,} of {count:,} runs{failed}"


def _samples(ready: PreparedSweep) -> int:
    """Samples that a row keeps of signals."""
    kept = ready.setup.kept
    if kept is None:
        return 0
    timing = ready.setup.variants[0].scenario.timing
    count = int((timing.stop - timing.start) / timing.step) // kept.stride + 1
    return count * (1 + len(kept.signals))


def _runner(by: Runner | int | str | None) -> Runner:
    if isinstance(by, str):
        return Cluster(by)
    return Local() if by is None else Local(by) if isinstance(by, int) else by
