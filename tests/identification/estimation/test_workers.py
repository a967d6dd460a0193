"""Pools of simulating processes: order, failures, crashes, and nothing left behind."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from fmus.errors import FmuError, IdentificationError, WiringError
from identification.estimation import workers
from identification.estimation.workers import LocalPool, ProcessPool, SimulationTask, open_pool
from orchestrator.fmi.isolation import Isolation
from tests.support.identification.closed_form import Moody

ANSWER, FAIL, DIE, BUG, SLEEP = ({"mood": float(mood)} for mood in range(5))


def _gone(pids):
    """Whether every process goes away; a minute is patience, not a claim."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and any(_alive(pid) for pid in pids):
        time.sleep(0.01)
    return not any(_alive(pid) for pid in pids)


def _alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_outcomes_come_in_the_order_of_the_tasks_whoever_simulated_them():
    tasks = [SimulationTask(window, {"x": float(x)}) for window in range(5) for x in range(7)]
    expected = LocalPool(Moody).run(tasks)
    with open_pool(Moody, 2) as pool:
        outcomes = pool.run(tasks)
        assert pool.run([]) == []
    assert all(np.array_equal(a, b) for a, b in zip(outcomes, expected, strict=True))
    assert [float(outcome[0, 0]) for outcome in outcomes] == [10 * t.window + t.values["x"] for t in tasks]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_failed_run_is_a_value_that_names_its_place(processes):
    with open_pool(Moody, processes) as pool:
        first, second, third = pool.run([SimulationTask(0, ANSWER), SimulationTask(4, FAIL), SimulationTask(1, ANSWER)])
    assert isinstance(second, FmuError)
    assert str(second) == "rig in window 4: does not want to"
    assert first[0, 0] == 0 and third[0, 0] == 10


class _Bounded(Moody):
    def simulate(self, window, values):
        raise WiringError("rig.friction", "is -1, outside its bounds [0, inf)", "choose a value inside")


def test_a_trial_outside_the_bounds_of_an_fmu_is_a_failed_run_not_the_end_of_the_study():
    (outcome,) = LocalPool(_Bounded).run([SimulationTask(0, ANSWER)])
    assert isinstance(outcome, FmuError) and str(outcome) == "rig.friction: is -1, outside its bounds [0, inf)"


def test_a_crashed_worker_costs_one_simulation_and_is_replaced():
    with ProcessPool(Moody, 2) as pool:
        before = set(pool.pids)
        outcomes = pool.run(
            [SimulationTask(0, ANSWER), SimulationTask(7, DIE), *[SimulationTask(w, ANSWER) for w in range(6)]]
        )
        pids = pool.pids
        assert len(pids) == 2 and len(before & set(pids)) == 1
    assert isinstance(outcomes[1], FmuError)
    assert "window 7" in str(outcomes[1]) and "exit code 7" in str(outcomes[1])
    assert not any(isinstance(outcome, FmuError) for i, outcome in enumerate(outcomes) if i != 1)
    assert _gone(before | set(pids))


def test_a_worker_that_hangs_costs_one_simulation_and_is_replaced():
    with open_pool(Moody, 1, Isolation(0.5)) as pool:
        (hung,) = pool.pids
        first, second = pool.run([SimulationTask(3, SLEEP), SimulationTask(1, ANSWER)])
        assert pool.pids != [hung] and _gone([hung])
    assert isinstance(first, FmuError) and str(first).startswith("window 3: the simulating process gave no answer for")
    assert second[0, 0] == 10


@pytest.mark.parametrize("isolation", [None, Isolation()])
def test_once_a_task_has_failed_no_other_of_its_group_is_begun(isolation):
    tasks = [
        SimulationTask(0, ANSWER),
        SimulationTask(1, FAIL, 5),
        SimulationTask(2, ANSWER, 5),
        SimulationTask(2, ANSWER),
        SimulationTask(3, ANSWER, 6),
    ]
    with open_pool(Moody, 1, isolation) as pool:
        first, failed, skipped, alone, other = pool.run(tasks)
    assert isinstance(failed, FmuError) and skipped is None
    assert [first[0, 0], alone[0, 0], other[0, 0]] == [0, 20, 30]


def test_workers_that_keep_dying_end_the_run_and_leave_nothing(monkeypatch):
    monkeypatch.setattr(workers, "MAX_RESTARTS", 1)
    with pytest.raises(FmuError, match="after 1 others"), ProcessPool(Moody, 1) as pool:
        pids = pool.pids
        pool.run([SimulationTask(0, DIE)] * 3)
    assert _gone(pids)


def test_a_bug_in_a_worker_is_raised_here_with_its_trace_and_leaves_nothing():
    with pytest.raises(ZeroDivisionError, match="a bug") as caught, ProcessPool(Moody, 2) as pool:
        pids = pool.pids
        pool.run([SimulationTask(0, SLEEP), SimulationTask(1, BUG)])
    assert "in simulate" in "".join(caught.value.__notes__)
    assert _gone(pids)


def test_an_interrupt_ends_workers_in_the_middle_of_a_run():
    with pytest.raises(KeyboardInterrupt), ProcessPool(Moody, 1) as pool:
        pids = pool.pids
        pool._processes._processes[0].send(SimulationTask(0, SLEEP))
        raise KeyboardInterrupt
    assert _gone(pids)


@pytest.mark.parametrize("processes", [1, 2])
def test_leaving_the_pool_closes_the_simulators(processes, tmp_path):
    log = tmp_path / "log"
    with open_pool(_Logged(str(log)), processes) as pool:
        pool.run([SimulationTask(0, ANSWER)])
        assert not log.exists()
    assert log.read_text() == "closed"


class _Logged:
    def __init__(self, log):
        self.log = log

    def __call__(self):
        return Moody(self.log)


def _no_simulator():
    raise FmuError("plant.fmu", "has no binary for this platform")


def test_a_factory_that_fails_is_reported_as_it_failed():
    with pytest.raises(FmuError, match=r"plant\.fmu: has no binary"), ProcessPool(_no_simulator, 2) as pool:
        pids = pool.pids
        pool.run([SimulationTask(0, ANSWER)])
    assert _gone(pids)


def test_fewer_than_one_process_is_refused():
    with pytest.raises(IdentificationError, match="processes: 0"):
        open_pool(Moody, 0)
