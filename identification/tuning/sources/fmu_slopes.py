"""Slopes of any Model Exchange FMU where it rests; see `equations.Slopes`.

They are its directional derivatives where it offers them, which differences have to bear out, and else the differences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from identification.tuning.sources.equations import ALIKE, SLOW, WIDTHS, Slopes
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuDescription, FmuFile, Kind
from orchestrator.trace import FloatArray

DIRECTIONAL, DIFFERENCES = "its directional derivatives", "differences of its derivatives and outputs"


def fmu_slopes(place: str, file: Path, values: Mapping[str, Any], count: int = 1) -> Slopes:
    """The FMU's matrices for N sets of values over its own.

    Args:
        place: of the component, for messages.
        values: variable -> one value, or (N,) one of each set.

    Raises:
        FmuFileError: it cannot be read.
        FmuError: it fails, or takes no such values.
        IdentificationError: it has no Model Exchange, does not rest where it starts, samples, has no slope there, or
            directional derivatives of its own making.
    """
    description = FmuDescription(file)
    if Kind.MODEL_EXCHANGE not in description.kinds:
        fix = "ask its supplier for Model Exchange, or identify a linear model of it (`method: subspace`)"
        raise IdentificationError(place, f"{file.name} has no Model Exchange, which would tell its slopes", fix)
    own = description.interface
    inputs, outputs = (tuple(port.name for port in own.of(side) if port.real) for side in ("input", "output"))
    with FmuFile(file, Kind.MODEL_EXCHANGE) as opened:
        slave = ExchangeSlave(opened, place)
        try:
            models, by = [], ""
            for number in range(count):
                slave.set({name: v[number] if isinstance(v, np.ndarray) else v for name, v in values.items()})
                resting = _Resting.of(place, slave, inputs, outputs)
                models.append(resting.matrices(place))
                by = DIFFERENCES if resting.directional is None else DIRECTIONAL
                slave.terminate()
                slave.reset()
        finally:
            slave.close()
    n, m = models[0].shape[1] - len(inputs), len(inputs)
    whole = np.stack(models)
    top, bottom = whole[:, :n], whole[:, n:]
    names = tuple(f"state {number + 1}" for number in range(n)), inputs, outputs
    return Slopes(top[:, :, :n], top[:, :, n : n + m], bottom[:, :, :n], bottom[:, :, n:], *names, by)


@dataclass(frozen=True, eq=False)
class _Resting:
    """An instance where it starts: states (n,) and inputs (m,) there, and directional derivatives (n + p, n + m)."""

    slave: ExchangeSlave
    states: FloatArray
    inputs: FloatArray
    directional: FloatArray | None

    @classmethod
    def of(cls, place: str, slave: ExchangeSlave, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> _Resting:
        slave.begin(0.0, None)
        slave.bind(inputs, outputs)
        slave.run()
        if math.isfinite(slave.next_event):
            raise IdentificationError(place, f"has an event at {slave.next_event:g} s", "leave what samples out of it")
        states, rest = slave.states(), np.array([float(slave.get(name)) for name in inputs])
        rates, _ = slave.answer(states, rest)
        if np.any(np.abs(rates) > SLOW):
            problem = f"does not rest where it starts: a state changes by {np.abs(rates).max():.3g} a second"
            raise IdentificationError(place, problem, "give start values at which it rests")
        return cls(slave, states, rest, slave.directional())

    def matrices(self, place: str) -> FloatArray:
        """(n + p, n + m) slopes of rates and outputs by states and inputs."""
        wide, narrow = (self._differences(width) for width in WIDTHS)
        if not np.isfinite(wide).all() or _apart(wide, narrow):
            fix = "switch off what does, such as dry friction, play and noise, by its parameters"
            raise IdentificationError(place, "jumps or bends where it rests", fix)
        if self.directional is None:
            return wide
        if not np.isfinite(self.directional).all() or _apart(self.directional, wide):
            problem = "has directional derivatives that differences of its derivatives and outputs do not bear out"
            raise IdentificationError(place, problem, "ask its supplier, or name its `model`")
        return self.directional

    def _differences(self, width: float) -> FloatArray:
        point = np.concatenate([self.states, self.inputs])
        columns = []
        for number in range(len(point)):
            ends = []
            for sign in (1, -1):
                moved = point.copy()
                moved[number] += sign * width
                ends.append(np.concatenate(self.slave.answer(*np.split(moved, [len(self.states)]))))
            columns.append((ends[0] - ends[1]) / (2 * width))
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0))


def _apart(one: FloatArray, other: FloatArray) -> bool:
    """Whether two estimates of slopes differ by more than rounding and curvature explain."""
    return bool(np.any(np.abs(one - other) > ALIKE * np.maximum(np.abs(one), np.abs(other)) + 1e-6))
