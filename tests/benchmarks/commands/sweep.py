"""What many points of energy control take, 10 s of each, with their rows written; and what of it is not simulation.

The scenario's system from starts and with mechanisms that differ, one expectation and one measure a run. Memory is that
of a process that keeps rows which nobody simulated, from one size of study to another.
"""

from __future__ import annotations

import json
import multiprocessing.connection
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import pyarrow.parquet as pq
from ruamel.yaml import YAML

from orchestrator.batch.sweep.runs import rows
from orchestrator.batch.sweep.runs.cluster import Cluster
from orchestrator.batch.sweep.runs.local import Local
from orchestrator.batch.sweep.runs.preparation import prepared
from orchestrator.batch.sweep.runs.queue import Queue
from orchestrator.batch.sweep.runs.rows import Row
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Setup
from orchestrator.batch.sweep.runs.worker import Worker
from orchestrator.batch.sweep.sweep import sweep
from orchestrator.engine import Run
from orchestrator.scenario.expectations import Check
from tests.support.dask_cluster import dask_cluster

from ..figure import Figure
from ..memory import peak_megabytes

SCENARIO = Path(__file__).parents[3] / "scenarios" / "butterfly" / "energy_control.yaml"
RUNS, LIMIT = 10_000, 40.0
ALONE = 1_000  # runs of which the parts are timed
ROWS = (1_000, 1_000_000)
VARY = {
    "hand.inertia": {"normal": 3.25e-3, "std": 1e-4},
    "hand.gravity_torque": {"normal": 0.04905, "std": 1.5e-3},
    "hand.viscous_friction": {"between": [0.5e-3, 2e-3], "scale": "log"},
    "hand.angle_start": {"between": [0.3, 0.9]},
    "controller.gain": {"between": [0.01, 0.03]},
}


def figures() -> list[Figure]:
    """Times, scaling, overhead and memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one, two = timed(folder, RUNS, 1), timed(folder, RUNS, 2)
        simulating, worker, keeping = parts(folder)
        small, large = (peak(folder, count) for count in ROWS)
        size = written(folder) / RUNS
        cluster = on_cluster(folder, two) if find_spec("distributed") else ("Dask is not there", "-")
    scaling = one / (2 * two)
    overhead = worker - simulating + keeping
    return [
        Figure(
            f"{RUNS:,} runs of 10 s, 2 processes of {os.cpu_count()} processors",
            f"at most {LIMIT:g} s",
            f"{two:.1f} s",
            two <= LIMIT,
        ),
        Figure(f"{RUNS:,} runs with 1 process", "-", f"{one:.1f} s"),
        Figure("a processor's share of the speed, 2 processes over 1", "0.9", f"{scaling:.2f}", scaling >= 0.9),
        Figure("processor time of a run, simulated alone", "-", f"{1e3 * simulating:.2f} ms"),
        Figure("the same with what judges it, draws its point and packs its row", "-", f"{1e3 * worker:.2f} ms"),
        Figure("keeping its row", "-", f"{1e3 * keeping:.3f} ms"),
        Figure(f"processor time of all {RUNS:,} runs so", "-", f"{RUNS * (worker + keeping):.1f} s"),
        Figure("overhead of a run", "less than 1 ms", f"{1e3 * overhead:.2f} ms", overhead < 1e-3),
        Figure(f"{RUNS:,} runs on two workers of a Dask cluster on this machine", "-", cluster[0]),
        Figure("what the cluster adds to a run on this machine", "-", cluster[1]),
        Figure("a row on the disk", "-", f"{size:.0f} bytes"),
        Figure(
            f"peak memory with {ROWS[0]:,} and {ROWS[1]:,} rows",
            "hardly more",
            f"{small:.0f} MB, {large:.0f} MB",
            large < 1.5 * small,
        ),
    ]


def study(folder: Path, runs: int) -> Path:
    """A study of so many runs."""
    document = YAML(typ="safe", pure=True).load(SCENARIO.read_text(encoding="utf-8"))
    del document["cases"]
    document["run"]["stop"] = 10
    document["expect"] = [{"signal": "hand.energy", "after": 9, "near": 0.0225482, "within": 2e-3}]
    (folder / "energy.yaml").write_text(json.dumps(document), encoding="utf-8")
    asked = {
        "title": "energy control",
        "sweep": "energy.yaml",
        "vary": VARY,
        "design": {"by": "monte-carlo", "samples": runs, "seed": 1},
        "measures": {"effort": {"signal": "motor.voltage", "effort": {"at_most": 1}}},
    }
    (folder / "study.yaml").write_text(json.dumps(asked), encoding="utf-8")
    return folder / "study.yaml"


def timed(folder: Path, runs: int, processes: int) -> float:
    """Wall time of a study with its rows, summary and report; FMUs come from the cache [s]."""
    file, out = study(folder, runs), folder / f"out-{runs}-{processes}"
    with prepared(file):
        pass
    begun = perf_counter()
    sweep(file, out, Local(processes))
    return perf_counter() - begun


def on_cluster(folder: Path, local: float) -> tuple[str, str]:
    """The study on two workers here, and the wall time a run that goes beyond that of two processes [s], in words."""
    file, out = study(folder, RUNS), folder / "out-cluster"
    with dask_cluster(folder) as cluster:
        begun = perf_counter()
        sweep(file, out, Cluster(cluster.address))
        spent = perf_counter() - begun
    same = pq.read_table(out / "runs").equals(pq.read_table(folder / f"out-{RUNS}-2" / "runs"))
    rows_told = "the same rows" if same else "OTHER ROWS"
    return f"{spent:.1f} s, {RUNS / spent:.0f} runs/s, {rows_told}", f"{1e3 * (spent - local) / RUNS:.2f} ms"


def written(folder: Path) -> int:
    """Bytes of the largest study's data set."""
    return sum(file.stat().st_size for file in (folder / f"out-{RUNS}-2" / "runs").iterdir())


def parts(folder: Path) -> tuple[float, float, float]:
    """Processor time of a run simulated alone, of its whole work, and of keeping its row [s]."""
    with prepared(study(folder, ALONE)) as ready:
        worker = Worker(ready.setup)
        task = Chunk(np.arange(ALONE), ready.design.points(0, ALONE))
        worker(task)
        begun = process_time()
        done = worker(task)
        spent = process_time() - begun
        simulation, case = worker._open(0), ready.setup.variants[0].scenario.cases[0]
        names = ready.setup.space.names
        runs = [
            Run({**case.values, **dict(zip(names, map(float, point), strict=True))}, {}, simulation.record)
            for point in task.points
        ]
        begun = process_time()
        for run in runs:
            simulation.simulation.execute(run)
        alone = process_time() - begun
        worker.close()
        begun = process_time()
        sweep(ready.file, folder / "kept", Repeating(done))
        kept = process_time() - begun
        begun = process_time()
        sweep(ready.file, folder / "kept", Repeating(done))
        kept -= process_time() - begun  # what does not depend on the rows: to prepare it, and to tell of it
    return alone / ALONE, spent / ALONE, max(kept, 0.0) / ALONE


@dataclass(frozen=True)
class Repeating:
    """Gives the rows of all runs at once."""

    done: ChunkResult

    def check(self) -> None:
        return

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        queue.answered(Chunk(np.arange(1), np.zeros((1, 1))), ChunkResult(b"", 0, 1e-9))
        for task in queue:
            table = rows.unpacked(self.done.rows).take(task.runs)
            done = ChunkResult(rows.packed(table), 0, 1e-9 * len(task.runs))
            queue.answered(task, done)
            yield task, done


@dataclass(frozen=True)
class Imagined:
    """Gives rows that nobody simulated."""

    def check(self) -> None:
        return

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        for task in queue:
            checks = [Check("", x > 1, "", x, x - 1) for x in task.points.sum(axis=1).tolist()]
            asked = range(len(setup.asked))
            made = [Row(rows.DONE, None, check.held, dict.fromkeys(asked, check)) for check in checks]
            done = ChunkResult(rows.packed(rows.table(setup, task, made)), 0, 1e-6 * len(task.runs))
            queue.answered(task, done)
            yield task, done


def peak(folder: Path, count: int) -> float:
    """Peak resident memory of a process that keeps, and tells of, so many rows [MB]."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_keep, args=(study(folder, count), folder / f"rows-{count}", theirs))
    process.start()
    found = float(ours.recv())
    process.join()
    return found


def _keep(file: Path, out: Path, told: multiprocessing.connection.Connection) -> None:
    sweep(file, out, Imagined())
    told.send(peak_megabytes())
