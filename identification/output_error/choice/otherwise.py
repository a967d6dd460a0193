"""Whether outputs that do not fit would, had they been recorded with the other sign or in the other unit of angle.

The search makes up for either as far as bounds let it, so that nothing of it is left to be seen in where it ended. So a
few windows are fitted anew, once for each way in which outputs may have been recorded otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import FmuError, InputError
from identification.output_error.free_runs.simulator import SystemFactory
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import fitted_only
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from identification.output_error.study import FreeRunSpec
from orchestrator.trace import FloatArray

_POOR = 0.7  # median FIT, below which something is wrong that may be this
_GOOD = 0.6  # FIT that a few windows have to reach otherwise, and
_LEFT = 0.4  # the share that may be left of what is missing of FIT
_WINDOWS, _ROUNDS = 3, 25  # that are fitted anew, and for so many iterations at most
_DEGREES = math.pi / 180
_WAYS = {
    -1.0: "with the other sign: a sensor or an input may be the other way round (`factor: -1`)",
    _DEGREES: "as degrees: they may be taken as radians (`traces.layout.units`, or `factor: 0.0174533`)",
    1 / _DEGREES: "as radians: they may be taken as degrees (`traces.layout.units`, or `factor: 57.2958`)",
}


@dataclass(frozen=True)
class _Refitted:
    """A few windows fitted anew: which outputs were taken otherwise, by which factor, and median FIT."""

    outputs: tuple[str, ...]
    factor: float
    fit: float


def recorded_otherwise(
    run: FreeRunSpec, problem: Problem, factory: SystemFactory, options: SearchOptions, found: Estimate
) -> list[str]:
    """A sentence about the way in which outputs would fit best, where they hardly fit and then do."""
    if not problem.parameters.free or not float(np.nanmedian(found.fit)) < _POOR:
        return []
    count = len(problem.windows)
    few = sorted({round(w) for w in np.linspace(0, count - 1, min(count, _WINDOWS))})
    brief = replace(options, starts=1, max_evaluations=_ROUNDS, intervals=IntervalOptions())
    before = float(np.nanmedian(found.fit[few]))
    tried = [one for one in _refitted(run, problem, factory, brief, few) if _better(one.fit, before)]
    if not tried:
        return []
    best = max(tried, key=lambda one: one.fit)
    return [
        f"outputs.{' and '.join(best.outputs)}: {len(few)} windows have a median FIT of {best.fit:.2f}, not of "
        f"{before:.2f}, once recordings are taken {_WAYS[best.factor]}"
    ]


def _better(fit: float, before: float) -> bool:
    return fit > _GOOD and 1 - fit < _LEFT * (1 - before)


def _refitted(
    run: FreeRunSpec, problem: Problem, factory: SystemFactory, options: SearchOptions, few: Sequence[int]
) -> Iterator[_Refitted]:
    outputs = problem.outputs
    for names in [*((name,) for name in outputs), *([outputs] if len(outputs) > 1 else [])]:
        for factor in _WAYS:
            scale = np.where([name in names for name in outputs], factor, 1.0)
            signals = {run.outputs[name].signal for name in names}
            read = {name: factor for name, spec in run.initial.items() if spec.signal in signals}
            asked = replace(
                problem,
                windows=tuple(_scaled(problem.windows[w], scale) for w in few),
                initial_states=tuple(
                    replace(state, start=tuple(read.get(state.name, 1.0) * state.start[w] for w in few))
                    for state in problem.initial_states
                ),
            )
            windows = [_read_otherwise(factory.windows[w], read) for w in few]
            try:
                fits = fitted_only(asked, replace(factory, windows=windows), options)
            except (FmuError, InputError):
                continue  # it cannot be fitted so
            yield _Refitted(names, factor, float(np.nanmedian(fits)))


def _scaled(window: Window, scale: FloatArray) -> Window:
    return replace(window, measured=window.measured * scale, weight=window.weight / np.abs(scale))


def _read_otherwise(window: FreeRunWindow, read: Mapping[str, float]) -> FreeRunWindow:
    """What its free run starts from where that is read off an output with an estimated delay."""
    readings = {name: replace(one, curve=read.get(name, 1.0) * one.curve) for name, one in window.readings.items()}
    return replace(window, readings=readings)
