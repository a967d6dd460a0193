"""Margins as goals: how much the loop bears where it is opened."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identification.tuning.goals.goal import Goal, LoopTrial, Measure, Need
from identification.tuning.loops import margins
from identification.tuning.loops.open_loop import OpenLoop
from orchestrator.trace import FloatArray

_OPENED: frozenset[Need] = frozenset({"opened"})


def _at(found: Callable[[OpenLoop], FloatArray]) -> Callable[[LoopTrial, Goal], FloatArray]:
    return lambda trial, goal: found(trial.loops.opened(goal.opened))


def _phase(loop: OpenLoop) -> FloatArray:
    return np.asarray(np.rad2deg(margins.phase_margins(loop)))


MEASURES: dict[str, Measure] = {
    "gain margin": Measure("dB", _at(margins.gain_margins), _OPENED, "gain that makes it unstable, up or down"),
    "phase margin": Measure("deg", _at(_phase), _OPENED, "phase that makes it unstable, either way"),
    "delay margin": Measure("s", _at(margins.delay_margins), _OPENED, "further delay that makes it unstable"),
    "modulus margin": Measure("1", _at(margins.modulus_margins), _OPENED, "least distance of L from -1"),
    "disk margin": Measure("1", _at(margins.disk_margins), _OPENED, "alpha of the balanced disk margin"),
}
