"""What steps show, as goals: of the reference, or of a disturbance at an input of the plant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identification.tuning.goals.goal import Goal, Measure, Moves, Need
from orchestrator import measures
from orchestrator.trace import FloatArray

LAST = 0.1  # of the response, over which it has ended
_SIGNAL: frozenset[Need] = frozenset({"signal"})
_COMMAND: frozenset[Need] = frozenset({"signal", "command"})
Figure = Callable[[FloatArray, FloatArray, float, Moves], float | None]  # (times, values, target, trial)


def _each(figure: Figure, relative: bool = False) -> Callable[[Moves, Goal], FloatArray]:
    """A figure of the goal's signal in every loop; inf where there is none."""

    def figures(trial: Moves, goal: Goal) -> FloatArray:
        time, target = trial.time(goal), trial.target(goal)
        found = []
        for values in trial.signal(goal):
            one = figure(time, values, target, trial)
            found.append(np.inf if one is None else one / (_divisor(values - target, trial, goal) if relative else 1.0))
        return np.array(found)

    return figures


def _divisor(error: FloatArray, trial: Moves, goal: Goal) -> float:
    if goal.relative == "reference":
        return abs(trial.test.height)
    if goal.relative == "peak":
        return max(float(np.abs(error).max()), 1e-300)
    return 1.0


def residual(trial: Moves, goal: Goal) -> FloatArray:
    """(N,) rms of the signal from the moment on at which what is tracked has settled; inf where it does not."""
    time, aim, found = trial.time(goal), trial.aim(goal), []
    for position, values in zip(trial.tracked(goal), trial.signal(goal), strict=True):
        settled = measures.settling_time(time, position, aim, trial.band)
        late = time >= (np.inf if settled is None else settled)
        found.append(measures.rms(time[late], values[late] - trial.target(goal)) if late.any() else np.inf)
    return np.array(found)


def _ended(t: FloatArray, y: FloatArray, target: float, trial: Moves) -> float:
    return abs(measures.steady_error(t, y, target, LAST * float(t[-1])))


def _overshoot(t: FloatArray, y: FloatArray, target: float, trial: Moves) -> float:
    return measures.overshoot(t, y, 0.0, target)


def _rise(t: FloatArray, y: FloatArray, target: float, trial: Moves) -> float | None:
    return measures.rise_time(t, y, 0.0, target)


def _settling(t: FloatArray, y: FloatArray, target: float, trial: Moves) -> float | None:
    return measures.settling_time(t, y, target, trial.band)


def _saturation(t: FloatArray, y: FloatArray, target: float, trial: Moves) -> float:
    return measures.saturated_share(t, y, -trial.test.limit, trial.test.limit)


MEASURES: dict[str, Measure] = {
    "overshoot": Measure("1", _each(_overshoot), _SIGNAL, "share of the step by which it goes beyond"),
    "settling time": Measure("s", _each(_settling), _SIGNAL, "from when on it stays within the band"),
    "rise time": Measure("s", _each(_rise), _SIGNAL, "from 10 to 90 % of the step"),
    "steady error": Measure("", _each(_ended), _SIGNAL, "distance from the target at the end"),
    "residual": Measure("", residual, _SIGNAL, "rms from the settling of what is tracked on"),
    "peak": Measure("", _each(lambda t, y, r, _: measures.peak(t, y)[0], True), _SIGNAL, "largest magnitude"),
    "itae": Measure(
        "", _each(lambda t, y, r, _: measures.itae(t, y - r), True), _SIGNAL, "integral of time times absolute error"
    ),
    "iae": Measure("", _each(lambda t, y, r, _: measures.iae(t, y - r), True), _SIGNAL, "integral of absolute error"),
    "ise": Measure("", _each(lambda t, y, r, _: measures.ise(t, y - r), True), _SIGNAL, "integral of squared error"),
    "effort": Measure("", _each(lambda t, y, r, _: measures.effort(t, y)), _COMMAND, "integral of the squared command"),
    "saturation": Measure("1", _each(_saturation), _COMMAND, "share of the time at the limit"),
}
