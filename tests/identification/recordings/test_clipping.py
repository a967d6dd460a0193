"""A recording that stops where its sensor's range ends, while the system goes on: told, with what to leave out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from identification.recordings.clipping import clipping_warnings
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import STEP, plain_study

TIME = np.arange(1001) * STEP
SWING = np.sin(3 * TIME) + 0.4 * np.sin(7.3 * TIME)


def told(recorded: FloatArray, simulated: FloatArray) -> list[str]:
    """What is said of a recording and free runs beside it, over windows of a second."""
    study = plain_study()
    trace = StudyTrace(Trace(TIME, {"voltage": SWING, "angle": recorded}, name="run"), {}, Path("run.csv"), "", "even")
    windows = cut_windows(study.run, [trace], study.windows)
    runs = [("run", window.time, np.interp(window.time, TIME, simulated)[:, None]) for window in windows]
    return list(clipping_warnings({"hand.angle": "angle"}, [trace], runs))


def test_a_range_that_ends_is_told_once_an_end_with_its_value() -> None:
    high, low = told(np.clip(SWING, -0.9, 1.1), SWING)
    assert high.startswith("outputs.hand.angle: angle of run stops at its highest value, 1.1, for ")
    assert "lowest value, -0.9" in low and "{signal: angle, below: LIMIT}" in low


def test_an_output_that_the_model_limits_as_well_is_not() -> None:
    limited = np.clip(SWING, -0.9, 1.1)
    assert told(limited, limited) == []
    assert told(SWING, SWING) == []
