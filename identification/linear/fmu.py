"""Linear models as FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError
from fmus.models.plants.state_space import matrices
from fmus.packaging import linear
from identification.linear.model import LinearModel
from identification.linear.preparation import Offsets
from identification.method import CalibratedFmu
from orchestrator.fmi.interface import Interface, Value
from orchestrator.trace import FloatArray


def linear_fmu(
    model: LinearModel, path: Path, units: Mapping[str, str] | None = None, zero: Offsets | None = None
) -> CalibratedFmu:
    """A `state_space` FMU of a model's size, built at this path, and what goes into it: matrices, and where it has its
    zero."""
    direct = model.d if np.any(model.d) else None
    about = None if zero is None else (zero.u.tolist(), zero.y.tolist())
    values = matrices(model.a, model.b, model.c, direct, zero=about)
    return CalibratedFmu(linear.build(model, path, units, zero=about), values)


def model_in(interface: Interface, place: str, values: Mapping[str, Value] | None = None) -> LinearModel:
    """The linear model that a `state_space` FMU holds.

    Args:
        place: for messages.
        values: variable -> value, over its start values.

    Raises:
        IdentificationError: it holds none, or an element has no value.
    """
    if interface.model_name != "state_space" or interface.shape("A") is None:
        raise IdentificationError(place, "is no `state_space` FMU", "linearise it first")
    given = values or {}
    a, b, c, d = (_array(place, interface, name, given) for name in "ABCD")
    inputs, outputs = (tuple(port.name for port in interface.of(side)) for side in ("input", "output"))
    step = float(given.get("sample_time", interface.ports["sample_time"].start or 0))
    return LinearModel(a, b, c, d if d.size else np.zeros((len(outputs), len(inputs))), step, inputs, outputs)


def zero_in(interface: Interface, place: str) -> Offsets | None:
    """What the model in a `state_space` FMU counts from; None where it is about the origin."""
    if interface.shape("u_zero") is None:
        return None
    return Offsets(*(_array(place, interface, name, {}) for name in ("u_zero", "y_zero")))


def _array(place: str, interface: Interface, name: str, values: Mapping[str, Value]) -> FloatArray:
    """An array of start values, with those that are given; empty where there is none."""
    shape = interface.shape(name)
    if shape is None:
        return np.zeros(0)
    found = np.zeros(shape)
    for at in np.ndindex(*shape):
        key = f"{name}[{','.join(str(i + 1) for i in at)}]"
        given = values.get(key, interface.ports[key].start)
        if given is None:
            raise IdentificationError(place, f"{key} has no start value", "calibrate the model again")
        found[at] = float(given)
    return found
