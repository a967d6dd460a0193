"""A Dask cluster gives the bytes that this machine gives, whatever happens to its workers and its scheduler."""

from __future__ import annotations

import json
import logging
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fmus.errors import InputError
from orchestrator.batch.sweep.runs import queue
from orchestrator.batch.sweep.runs.cluster import Cluster
from orchestrator.batch.sweep.runs.package import WorkerPackage, WorkerPlatform
from orchestrator.batch.sweep.runs.preparation import prepared
from orchestrator.batch.sweep.sweep import sweep
from tests.support.dask_cluster import DaskCluster, dask_cluster
from tests.support.sweeping import FALLING, Here, results, study

LONGER = FALLING | {"run": {"stop": 10, "step": 0.001}}


@pytest.fixture
def small_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """So many tasks that something can happen between them."""
    monkeypatch.setattr(queue, "LONG", 0.03)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with dask_cluster(tmp_path_factory.mktemp("dask")) as found:
        yield found


def lines(out: Path) -> list[dict[str, object]]:
    found = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    return [line for line in found if "runs" in line]


def ran(out: Path) -> list[int]:
    return [run for line in lines(out) for first, last in line["runs"] for run in range(first, last + 1)]  # type: ignore[attr-defined]


def once(do: Callable[[], None], after: float) -> Callable[[float, str], None]:
    """Does it when that share of the runs is done."""
    done = []

    def told(fraction: float, doing: str) -> None:
        if fraction >= after and not done:
            done.append(fraction)
            do()

    return told


def larger(folder: Path) -> Path:
    return study(folder, LONGER, design={"by": "monte-carlo", "samples": 120, "seed": 3}, traces=None)


@pytest.mark.slow
@pytest.mark.needs("dask")
@pytest.mark.usefixtures("small_tasks")
def test_two_workers_share_the_runs_and_give_what_one_process_gives(shared: DaskCluster, tmp_path: Path) -> None:
    file = larger(tmp_path)
    sweep(file, tmp_path / "here", Here())
    sweep(file, tmp_path / "there", Cluster(shared.address))
    assert results(tmp_path / "there") == results(tmp_path / "here")
    assert sorted(ran(tmp_path / "there")) == list(range(120))
    assert len({line["by"] for line in lines(tmp_path / "there")}) == 2


@pytest.mark.slow
@pytest.mark.needs("dask")
@pytest.mark.usefixtures("small_tasks")
def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path) -> None:
    file = larger(tmp_path)
    sweep(file, tmp_path / "here", Here())
    with dask_cluster(tmp_path / "dask") as own:
        sweep(file, tmp_path / "there", Cluster(own.address), once(own.kill_a_worker, 0.2))
    assert results(tmp_path / "there") == results(tmp_path / "here")
    assert sorted(ran(tmp_path / "there")) == list(range(120))


@pytest.mark.slow
@pytest.mark.needs("dask")
@pytest.mark.usefixtures("small_tasks")
def test_a_scheduler_that_is_killed_and_comes_again_costs_nothing(tmp_path: Path) -> None:
    file = larger(tmp_path)
    sweep(file, tmp_path / "here", Here())
    with dask_cluster(tmp_path / "dask", 1) as own:
        sweep(file, tmp_path / "there", Cluster(own.address), once(own.restart, 0.2))
    assert results(tmp_path / "there") == results(tmp_path / "here")
    assert sorted(ran(tmp_path / "there")) == list(range(120))


@pytest.mark.slow
@pytest.mark.needs("dask")
def test_a_scheduler_that_does_not_come_again_leaves_what_was_done(tmp_path: Path) -> None:
    file = larger(tmp_path)
    with dask_cluster(tmp_path / "dask", 1) as own:
        gone = once(own.close, 0.02)
        with pytest.raises(InputError, match=f"--scheduler {own.address}: no scheduler answers there"):
            sweep(file, tmp_path / "out", Cluster(own.address, patience=0.5), gone)
        own.close = lambda: None  # type: ignore[method-assign]
    there = ran(tmp_path / "out")
    assert 0 < len(there) < 120
    sweep(file, tmp_path / "out", Here())
    sweep(file, tmp_path / "here", Here())
    assert results(tmp_path / "out") == results(tmp_path / "here")
    assert sorted(ran(tmp_path / "out")) == list(range(120))


@pytest.mark.slow
@pytest.mark.needs("dask")
def test_a_worker_needs_no_compiler(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    environment = {"PATH": str(tmp_path / "bin"), "CC": "/none", "SERVOTWIN_CACHE": str(tmp_path / "cache")}
    with dask_cluster(tmp_path / "dask", 0) as own:
        own.add_worker(environment)
        result = sweep(study(tmp_path), tmp_path / "out", Cluster(own.address))
    assert result.document["failed"] == 0 and not (tmp_path / "cache").exists()


@pytest.mark.slow
@pytest.mark.needs("dask")
def test_a_worker_of_another_version_is_refused_before_anything_runs(tmp_path: Path) -> None:
    other = tmp_path / "other" / "servotwin-99.0.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: servotwin\nVersion: 99.0\n")
    with dask_cluster(tmp_path / "dask", 0) as own:
        own.add_worker({"PYTHONPATH": str(other.parent)})
        with pytest.raises(InputError, match=r"worker tcp://.*: has servotwin 99\.0, not"):
            sweep(study(tmp_path), tmp_path / "out", Cluster(own.address))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.needs("dask")
def test_a_worker_whose_disk_takes_nothing_is_told_and_others_do_its_runs(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = study(tmp_path)
    sweep(file, tmp_path / "here", Here())
    with dask_cluster(tmp_path / "dask", 1) as own:
        own.add_worker(prefix="ulimit -f 8;")
        with caplog.at_level(logging.WARNING, "servotwin.sweep"):
            sweep(file, tmp_path / "there", Cluster(own.address))
    assert results(tmp_path / "there") == results(tmp_path / "here")
    assert any("its runs go to others" in line for line in caplog.messages)


@pytest.mark.needs("dask")
def test_a_dead_address_is_told_at_once() -> None:
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:1: no scheduler answers there"):
        Cluster("tcp://127.0.0.1:1").check()
    with pytest.raises(InputError, match=r"--scheduler nonsense: "):
        Cluster("nonsense").check()


def test_without_dask_a_cluster_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(InputError, match=r"needs Dask .*pip install 'servotwin\[dask\]'"):
        Cluster("tcp://127.0.0.1:1").check()


def test_a_worker_knows_a_package_by_the_name_that_it_has_here(tmp_path: Path) -> None:
    """A worker that answers to another name than it is asked by gets its task again and again."""
    with prepared(larger(tmp_path)) as ready:
        package = WorkerPackage.of(ready.setup)
    there = pickle.loads(pickle.dumps(package))  # whose own pickle is longer: names are no longer one object
    again = pickle.loads(pickle.dumps(there))
    assert pickle.dumps(there) != pickle.dumps(package) and package.key == there.key == again.key


@pytest.mark.slow
@pytest.mark.needs("dask")
def test_a_worker_that_does_not_keep_what_it_is_given_is_left_alone(
    shared: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def renamed(self: WorkerPackage) -> tuple[type[WorkerPackage], tuple[object, ...]]:
        return WorkerPackage, (self.setup, self.files, self.platform, "another")

    monkeypatch.setattr(WorkerPackage, "__reduce__", renamed)
    monkeypatch.setattr("distributed.Client.register_plugin", lambda self, plugin: None)
    with pytest.raises(InputError, match="does not keep the FMUs that it is given"):
        sweep(study(tmp_path), tmp_path / "out", Cluster(shared.address))


@pytest.mark.parametrize(
    ("version", "machine", "problem"),
    [
        (None, "linux x86_64", "has no servotwin; install 1.0 there"),
        ("0.9", "linux x86_64", "has servotwin 0.9, not 1.0; install that there"),
        ("1.0", "darwin arm64", "is darwin arm64, and the FMUs are for linux x86_64; "),
        ("1.0", "linux x86_64", ""),
    ],
)
def test_a_worker_has_to_be_like_the_machine_that_asks(version: str | None, machine: str, problem: str) -> None:
    found = WorkerPlatform(version, machine).unfit(WorkerPlatform("1.0", "linux x86_64"))
    assert found.startswith(problem) and bool(found) == bool(problem)
