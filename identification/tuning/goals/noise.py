"""Amplification of measurement noise as a goal."""

from __future__ import annotations

import numpy as np

from identification.tuning.goals.goal import Goal, LoopTrial, Measure
from orchestrator.trace import FloatArray


def amplification(trial: LoopTrial, goal: Goal) -> FloatArray:
    """(N,) rms of the first command over that of white noise on the goal's signal, which is tracked by default."""
    number = trial.loops.wiring.tracked if goal.signal is None else goal.signal.number
    command = trial.loops.wiring.commanded[0].target
    gain = trial.loops.noise_gain(number)[:, command]
    return np.where(np.isfinite(gain), gain, np.inf)


MEASURES: dict[str, Measure] = {
    "noise gain": Measure("", amplification, frozenset({"noise"}), "rms of the command over that of white noise"),
}
