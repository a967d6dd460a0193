"""Loops of random plants under a static controller, and what a dense grid and python-control say of them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import control
import numpy as np
from scipy.optimize import minimize_scalar

from identification.linear.model import LinearModel
from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet
from identification.tuning.loops.wiring import LoopWiring, Path
from tests.support.identification.linear_systems import random_system

MEASURED, COMMANDED = Path("plant.y -> controller.y", 0, 1), Path("controller.u -> plant.u", 0, 0)
WIRING = LoopWiring((MEASURED,), (COMMANDED,), 0, 0, (2, 1, 1, 1))


@dataclass(frozen=True)
class Known:
    """Margins as python-control finds them [dB, degrees], with what it leaves out: the end of the frequencies."""

    gain: float
    phase: float
    modulus: float


def plant(seed: int, pairs: int = 2, real: int = 1) -> LinearModel:
    """A random plant whose largest gain is 1, without feed-through."""
    model = random_system(seed, pairs=pairs, real=real, outputs=1)
    peak = np.abs(model.frequency_response(np.linspace(0.1, np.pi / model.step, 400))).max()
    return LinearModel(model.a, model.b / peak, model.c, np.zeros((1, 1)), model.step, ("u",), ("y",))


def proportional(gain: float, step: float) -> LinearModel:
    """u = gain (r - y)."""
    nothing = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0))
    return LinearModel(*nothing, np.array([[gain, -gain]]), step, ("r", "y"), ("u",))


def loops(model: LinearModel, gain: float) -> Loops:
    """The loop of one plant."""
    return Loops(PlantSet.of({"plant": model}), ControllerSet.of([proportional(gain, model.step)]), WIRING)


def known(model: LinearModel, gain: float) -> Known:
    """What python-control says; crossings at which its polynomials only come near the circle do not count."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = control.ss(model.a, gain * model.b, model.c, 0, model.step)
        gains, phases, _, _, crossed, _ = control.stability_margins(system, returnall=True, method="poly")
    there = np.abs(gain * model.frequency_response(np.asarray(crossed))[:, 0, 0]) if len(crossed) else np.zeros(0)
    phases = np.abs(phases)[np.abs(there - 1) < 1e-6]
    end = float((gain * model.frequency_response(np.array([np.pi / model.step])))[0, 0, 0].real)
    gains = np.append(gains[gains > 0], [1 / -end] if end < 0 else [])
    grid = np.linspace(1e-3, np.pi / model.step, 40_001)

    def distance(omega: float) -> float:
        return float(np.abs(1 + gain * model.frequency_response(np.array([omega]))[0, 0, 0]))

    at = int(np.abs(1 + gain * model.frequency_response(grid)[:, 0, 0]).argmin())
    ends = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    nearest = min(
        minimize_scalar(distance, bounds=ends, method="bounded", options={"xatol": 1e-10}).fun, distance(grid[at])
    )
    decibels = np.abs(20 * np.log10(gains)).min(initial=np.inf)
    return Known(float(decibels), float(phases.min(initial=np.inf)), float(nearest))


def touches(model: LinearModel, gain: float) -> bool:
    """Whether |L| only just comes to 1 somewhere, or L to the real axis: a matter of rounding then."""
    grid = np.linspace(1e-3, np.pi / model.step, 40_001)[:-1]
    value = gain * model.frequency_response(grid)[:, 0, 0]
    for figure, size in ((np.log(np.abs(value)), 1.0), (value.imag, float(np.abs(value).max()))):
        turning = np.flatnonzero(np.diff(np.sign(np.diff(figure)))) + 1
        if np.any(np.abs(figure[turning]) < 1e-3 * size):
            return True
    return False
