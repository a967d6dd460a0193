"""Tables with signals that come less often than their rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.recordings.campaign import TraceSource, load_campaign
from identification.recordings.rates import filled
from orchestrator.trace import Trace

TIME = 0.01 * np.arange(400)
BOTH = {"command", "angle"}


def slow(values: np.ndarray, each: int, first: int = 0) -> np.ndarray:
    """The samples (K,) of every so many rows, from one on."""
    rows = np.arange(len(values))
    return np.where((rows >= first) & ((rows - first) % each == 0), values, np.nan)


def test_what_is_measured_runs_linearly_and_commands_are_held_between_their_samples() -> None:
    trace = Trace(TIME, {"command": slow(np.arange(400.0), 4), "angle": slow(2 * TIME, 10, 3)})
    made, notes = filled(trace, BOTH, {"angle"})
    assert (made.time[0], made.time[-1]) == (TIME[3], TIME[393])
    assert made["angle"] == pytest.approx(2 * made.time)
    assert made["command"].tolist() == [float(row // 4 * 4) for row in range(3, 394)]
    assert notes == (
        "signal 'angle' comes every 0.1 s, in one of 10 rows, and runs linearly between its samples",
        "signal 'command' comes every 0.04 s, in one of 4 rows, and keeps its value until the next",
    )


def test_gaps_of_a_slow_signal_stay_gaps() -> None:
    angle = slow(2 * TIME, 10)
    angle[100:200] = np.nan
    made, _ = filled(Trace(TIME, {"angle": angle}), {"angle"}, {"angle"})
    assert np.isnan(made["angle"][91:200]).all()
    assert np.isfinite(made["angle"][:91]).all() and np.isfinite(made["angle"][200:]).all()


@pytest.mark.parametrize(
    "angle",
    [
        np.where(np.arange(400) == 7, np.nan, TIME),  # one is missing
        np.where(np.random.default_rng(1).random(400) < 0.1, TIME, np.nan),  # as they like
        slow(TIME, 90),  # too few
        np.full(400, np.nan),
    ],
)
def test_what_does_not_come_evenly_is_left_as_it_is(angle: np.ndarray) -> None:
    trace = Trace(TIME, {"angle": angle})
    assert filled(trace, {"angle"}, {"angle"}) == (trace, ())


def test_signals_of_no_study_stay_as_they_are() -> None:
    trace = Trace(TIME, {"angle": TIME, "heat": slow(TIME, 10)})
    assert filled(trace, {"angle"}, {"angle"}) == (trace, ())


def test_a_campaign_says_what_came_less_often(tmp_path: Path) -> None:
    rows = "".join(f"{t:.2f},{k},{2 * t if k % 10 == 0 else ''}\n" for k, t in enumerate(TIME))
    (tmp_path / "a.csv").write_text("time [s],command,angle\n" + rows)
    source = TraceSource(tmp_path, files="*.csv", used=frozenset(BOTH), linear=frozenset({"angle"}))
    (found,) = load_campaign(source)
    assert found.trace["angle"] == pytest.approx(2 * found.trace.time)
    assert any("'angle' comes every 0.1 s" in note for note in found.notes)
