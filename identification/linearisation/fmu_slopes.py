"""Slopes of any Model Exchange FMU where it rests; see `equations.Slopes`.

They are its directional derivatives where it offers them, which differences have to bear out, and else the differences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from identification.linearisation.slopes import (
    DIFFERENCES,
    DIRECTIONAL,
    SLOW,
    WIDTHS,
    Slopes,
    Standing,
    apart,
    central,
    quarters,
)
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuDescription, FmuFile, FmuKind
from orchestrator.trace import FloatArray


def fmu_slopes(place: str, file: Path, values: Mapping[str, Any], count: int = 1, at: Standing | None = None) -> Slopes:
    """The FMU's matrices for N sets of values over its own.

    Args:
        place: of the component, for messages.
        values: variable -> one value, or (N,) one of each set.
        at: where it is; None takes where it starts, and rests.

    Raises:
        FmuFileError: it cannot be read.
        FmuError: it fails, or takes no such values.
        IdentificationError: it has no Model Exchange, does not rest where it starts, samples, has no slope there, or
            directional derivatives of its own making.
    """
    description = FmuDescription(file)
    if FmuKind.MODEL_EXCHANGE not in description.kinds:
        fix = "ask its supplier for Model Exchange, or identify a linear model of it (`method: subspace`)"
        raise IdentificationError(place, f"{file.name} has no Model Exchange, which would tell its slopes", fix)
    own = description.interface
    standing = at and replace(at, states={name: at.states[name] for name in description.state_names})
    inputs, outputs = (tuple(port.name for port in own.of(side) if port.real) for side in ("input", "output"))
    with FmuFile(file, FmuKind.MODEL_EXCHANGE) as opened:
        slave = ExchangeSlave(opened, place)
        try:
            models, by, moving = [], "", 0.0
            for number in range(count):
                slave.set({name: v[number] if isinstance(v, np.ndarray) else v for name, v in values.items()})
                resting = _Resting.of(place, slave, inputs, outputs, standing)
                moving = max(moving, resting.moving)
                models.append(resting.matrices(place))
                by = DIFFERENCES if resting.directional is None else DIRECTIONAL
                slave.terminate()
                slave.reset()
        finally:
            slave.close()
    n = models[0].shape[1] - len(inputs)
    names = tuple(f"state {number + 1}" for number in range(n)), inputs, outputs
    return Slopes(*quarters(np.stack(models), n), *names, by, moving)


@dataclass(frozen=True, eq=False)
class _Resting:
    """An instance where it is: states (n,) and inputs (m,) there, and directional derivatives (n + p, n + m).

    Attributes:
        moving: how fast a state changes at most.
    """

    slave: ExchangeSlave
    states: FloatArray
    inputs: FloatArray
    directional: FloatArray | None
    moving: float

    @classmethod
    def of(
        cls, place: str, slave: ExchangeSlave, inputs: tuple[str, ...], outputs: tuple[str, ...], at: Standing | None
    ) -> _Resting:
        slave.begin(0.0 if at is None else at.time, None)
        slave.bind(inputs, outputs)
        slave.run()
        if math.isfinite(slave.next_event):
            raise IdentificationError(place, f"has an event at {slave.next_event:g} s", "leave what samples out of it")
        states, rest = slave.states(), np.array([float(slave.get(name)) for name in inputs])
        if at is not None:
            states = np.array([*at.states.values()])
            rest = np.array([at.inputs[name] for name in inputs])
        rates, _ = slave.answer(states, rest)
        moving = float(np.abs(rates).max(initial=0.0))
        if at is None and moving > SLOW:
            problem = f"does not rest where it starts: a state changes by {moving:.3g} a second"
            raise IdentificationError(place, problem, "give start values at which it rests")
        return cls(slave, states, rest, slave.directional(), moving)

    def matrices(self, place: str) -> FloatArray:
        """(n + p, n + m) slopes of rates and outputs by states and inputs."""
        point = np.concatenate([self.states, self.inputs])
        wide, narrow = (central(self._answer, point, width) for width in WIDTHS)
        if not np.isfinite(wide).all() or apart(wide, narrow):
            fix = "switch off what does, such as dry friction, play and noise, by its parameters"
            raise IdentificationError(place, "jumps or bends where it rests", fix)
        if self.directional is None:
            return wide
        if not np.isfinite(self.directional).all() or apart(self.directional, wide):
            problem = "has directional derivatives that differences of its derivatives and outputs do not bear out"
            raise IdentificationError(place, problem, "ask its supplier, or name its `model`")
        return self.directional

    def _answer(self, point: FloatArray) -> FloatArray:
        return np.concatenate(self.slave.answer(*np.split(point, [len(self.states)])))
