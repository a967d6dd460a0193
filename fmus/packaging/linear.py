"""An identified linear model as an FMU: the library's `state_space` of its size, with its matrices inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fmus.errors import ModelError
from fmus.models.plants.state_space import matrices, state_space
from fmus.packaging import targets


class LinearSystem(Protocol):
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

    Attributes:
        a, b, c, d: (n, n), (n, m), (p, n), (p, m).
        step: sampling time [s].
        inputs, outputs: names of the m inputs and p outputs; identifiers.
    """

    @property
    def a(self) -> Any: ...
    @property
    def b(self) -> Any: ...
    @property
    def c(self) -> Any: ...
    @property
    def d(self) -> Any: ...
    @property
    def step(self) -> float: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def outputs(self) -> tuple[str, ...]: ...


def build(
    system: LinearSystem,
    path: Path,
    units: Mapping[str, str] | None = None,
    start: Sequence[float] | None = None,
    zero: tuple[Sequence[float], Sequence[float]] | None = None,
    target: str | None = None,
    fmi: int = 2,
) -> Path:
    """Write the FMU of a linear model; the path comes back.

    A D that is not zero makes the outputs react at once; without one the FMU has no such parameter.

    Args:
        units: units of inputs and outputs, "1" by default.
        start: (n,) state at the start, the origin by default.
        zero: (m,) of the inputs and (p,) of the outputs that the matrices are about; 0 without, and no parameters.
        target: "native" or "python"; None takes the preferred one.

    Raises:
        ModelError: a name that is no identifier, a matrix that is not finite, and what the packagings refuse.
    """
    inputs, outputs = _with_units(system.inputs, units), _with_units(system.outputs, units)
    direct = bool(np.any(np.asarray(system.d) != 0))
    try:
        model = state_space(len(system.a), inputs, outputs, direct, zero is not None)
    except ValueError as error:
        raise ModelError("linear model", str(error), "name inputs and outputs by distinct identifiers") from error
    values = matrices(system.a, system.b, system.c, system.d if direct else None, start, zero)
    values["sample_time"] = float(system.step)
    return targets.build(model, path, target=target, fmi=fmi, parameters=values)


def _with_units(names: Sequence[str], units: Mapping[str, str] | None) -> dict[str, str]:
    return {name: (units or {}).get(name, "1") for name in names}
