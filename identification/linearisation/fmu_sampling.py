"""What a running FMU of the library does at one of its instants: by the tangents that it carries over a step.

They are exact on the side of a kink that its values are on; steps from inputs a little beside have to bear them out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmus.errors import IdentificationError, TangentsMissing
from identification.linearisation.slopes import TANGENTS, WIDTHS, Sampling, Slopes, apart, central, quarters
from orchestrator.fmi.interface import along
from orchestrator.fmi.slave import Slave
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Stopped:
    """An instance between two steps.

    Attributes:
        saved: its snapshot there.
        time: [s].
        inputs: name -> value from there on.
    """

    slave: Slave
    saved: Any
    time: float
    inputs: dict[str, float]


def fmu_sampling(place: str, at: Stopped, outputs: Sequence[str], period: float) -> Sampling:
    """What it does at an instant of its own, which the stop is, and gives out until the next.

    Raises:
        IdentificationError: it jumps or bends there.
        FmuError: it fails.
    """
    states = _states(at)
    found = _tangents(place, at, states, outputs, period)
    return Sampling(*quarters(found, len(states)), tuple(at.inputs), tuple(outputs), period, TANGENTS)


def fmu_gains(place: str, at: Stopped, outputs: Sequence[str]) -> Slopes:
    """How the outputs of an FMU without states follow its inputs.

    Raises:
        IdentificationError: they jump or bend there.
        FmuError: it fails.
    """
    d = _tangents(place, at, (), outputs, 0.0)[None]
    p, m = d.shape[1:]
    return Slopes(
        np.zeros((1, 0, 0)),
        np.zeros((1, 0, m)),
        np.zeros((1, p, 0)),
        d,
        (),
        tuple(at.inputs),
        tuple(outputs),
        TANGENTS,
    )


def _states(at: Stopped) -> list[str]:
    """Names of what can be given tangents, and is computed: its states."""
    ports = at.slave.interface.ports.values()
    found = []
    for port in ports:
        if port.real and port.causality in ("local", "output"):
            try:
                at.slave.carry(1, {port.name: 0})
            except TangentsMissing:
                continue
            found.append(port.name)
    at.slave.carry(0, {})
    return found


def _tangents(place: str, at: Stopped, states: Sequence[str], outputs: Sequence[str], period: float) -> FloatArray:
    """(n + p, n + m) of the states after a step, and of the outputs, by the states before it and the inputs."""
    slave, inputs = at.slave, [*at.inputs]
    knowns, results = [*states, *inputs], [*states, *outputs]
    if not knowns:
        return np.zeros((len(results), 0))
    slave.restore(at.saved)
    slave.carry(len(knowns), {name: number for number, name in enumerate(knowns)})
    slave.bind(inputs, [name for result in results for name in along(result, len(knowns))])
    _step(at, list(at.inputs.values()), period)
    found = np.array(slave.read(), dtype=float).reshape(len(results), len(knowns))
    slave.carry(0, {})
    slave.bind(inputs, results)
    point = np.array(list(at.inputs.values()))
    wide, narrow = (central(lambda moved: _answer(at, moved, period), point, width) for width in WIDTHS)
    if not np.isfinite(found).all() or apart(wide, narrow) or apart(found[:, len(states) :], wide):
        fix = "switch off what does by its parameters, such as noise, rounding and compensation of friction"
        raise IdentificationError(place, "jumps or bends where it is", fix)
    return found


def _answer(at: Stopped, inputs: FloatArray, period: float) -> FloatArray:
    """The bound outputs under these inputs (m,)."""
    at.slave.restore(at.saved)
    _step(at, inputs.tolist(), period)
    return np.array(at.slave.read(), dtype=float)


def _step(at: Stopped, inputs: list[float], period: float) -> None:
    at.slave.write(inputs)
    if period > 0:
        at.slave.step(at.time, period)
