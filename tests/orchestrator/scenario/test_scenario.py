"""What a data logger leaves of a run."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.scenario.scenario import DataLogger
from orchestrator.trace import Trace

SIGNALS = {"x": "rig.position"}


def run(start: float = 0.0, stop: float = 2.0) -> Trace:
    """The time since the start [s], recorded every millisecond."""
    count = round((stop - start) * 1000) + 1
    elapsed = 0.001 * np.arange(count)
    return Trace(start + elapsed, {"rig.position": elapsed}, {"rig.position": "m"}, "run")


@pytest.mark.parametrize("start", [0.0, 5.0])
def test_an_even_logger_samples_after_each_whole_period_and_not_at_the_start(start: float) -> None:
    found = DataLogger(SIGNALS, every=0.1, jitter=0.0).sample(run(start, start + 2), 0)
    assert found.time == pytest.approx(start + 0.1 * np.arange(1, len(found) + 1))
    assert len(found) in (19, 20)  # the last one may be rounded beyond the end


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("first", [0.0, 0.025, 0.7])
def test_the_first_sample_is_where_it_is_asked_for_and_the_gaps_stay(jitter: float, first: float) -> None:
    logger = {"signals": SIGNALS, "every": 0.05, "jitter": jitter, "seed": 4}
    moved, plain = (DataLogger(**logger, first=time).sample(run(), 1) for time in (first, None))
    assert moved.time[0] == pytest.approx(first)
    count = min(len(moved), len(plain))
    assert np.diff(moved.time)[: count - 1] == pytest.approx(np.diff(plain.time)[: count - 1])


def test_gaps_have_the_mean_and_the_spread_that_are_asked_for() -> None:
    gaps = np.diff(DataLogger(SIGNALS, every=0.002, jitter=0.2).sample(run(stop=20.0), 0).time)
    assert np.mean(gaps) == pytest.approx(0.002, rel=0.02)
    assert np.std(gaps) == pytest.approx(0.2 * 0.002, rel=0.05)


def test_a_sample_is_the_last_value_before_its_instant_under_the_name_of_the_recording() -> None:
    found = DataLogger(SIGNALS, every=0.0375, seed=1).sample(run(), 0)
    assert found.names == ("x",) and found.unit("x") == "m"
    late = found.time - found["x"]
    assert np.all(late > -1e-8) and np.all(late < 0.001 + 1e-8)


def test_runs_and_seeds_have_instants_of_their_own_and_the_same_ones_again() -> None:
    def instants(seed: int, number: int) -> list[float]:
        return DataLogger(SIGNALS, every=0.05, seed=seed).sample(run(), number).time.tolist()

    assert instants(0, 0) == instants(0, 0)
    assert len({tuple(instants(seed, number)[:5]) for seed in (0, 1) for number in (0, 1)}) == 4
