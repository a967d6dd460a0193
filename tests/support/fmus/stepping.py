"""Steps a model's instance over a grid of equal steps, for tests that compare it with an independent answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fmus.modelling.instance import Instance
from fmus.modelling.model import Model, Table
from orchestrator.trace import FloatArray

Signal = Callable[[float], float]


def stepped(
    model: Model,
    values: Mapping[str, float],
    outputs: Sequence[str],
    time: FloatArray,
    inputs: Mapping[str, Signal] | None = None,
    tables: Mapping[str, Table] | None = None,
) -> FloatArray:
    """(K, len(outputs)) outputs at the instants `time` (K,); inputs are held from each instant to the next."""
    instance = Instance(model, dict(values), dict(tables or {}))
    instance.begin(float(time[0]))
    rows = [[instance.get(name) for name in outputs]]
    for now, after in zip(time[:-1].tolist(), time[1:].tolist(), strict=True):
        for name, signal in (inputs or {}).items():
            instance.set(name, signal(now))
        instance.step(now, after - now)
        rows.append([instance.get(name) for name in outputs])
    return np.array(rows)


def grid(stop: float, step: float) -> FloatArray:
    """Instants 0, step, ... up to stop, each computed from its number [s]."""
    return np.arange(round(stop / step) + 1, dtype=np.float64) * step


def sampled(
    model: Model,
    values: Mapping[str, float],
    outputs: Sequence[str],
    inputs: Mapping[str, Sequence[float] | FloatArray],
    period: float = 1 / 300,
) -> FloatArray:
    """(K, len(outputs)) outputs right after each of K samples, at which the inputs have these values."""
    [count] = {len(series) for series in inputs.values()}
    signals = {name: lambda t, series=series: float(series[round(t / period)]) for name, series in inputs.items()}
    return stepped(model, values, outputs, np.arange(count + 1) * period, signals)[1:]
