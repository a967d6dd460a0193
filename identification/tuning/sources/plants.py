"""Plants of a study that are linear, sampled models as they come, with the units of their signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Interface, Value
from orchestrator.trace import FloatArray

NAMES = ("A", "B", "C", "D")


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """A linear model, the units of its inputs and outputs that have one, and what a reader must know of it."""

    model: LinearModel
    units: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


class PlantSpec(Protocol):
    """What a study names as a plant."""

    def linear(self, place: str, step: float) -> LinearPlant:
        """Its linear model; one that has no sampling time of its own is sampled every `step` [s]."""


@dataclass(frozen=True)
class FmuPlant:
    """An FMU with values over its own: the library's `state_space`, which is linear as it is."""

    file: Path
    values: Mapping[str, Value] = field(default_factory=dict)

    def linear(self, place: str, step: float) -> LinearPlant:
        """The model in the FMU.

        Raises:
            FmuFileError: it cannot be read.
            IdentificationError: it is no linear model.
        """
        interface = FmuDescription(self.file, None, self.values).interface
        if interface.model_name != "state_space" or interface.shape("A") is None:
            raise IdentificationError(place, f"{self.file.name} is no `state_space` FMU", "linearise it first")
        a, b, c, d = (_array(place, interface, name, self.values) for name in NAMES)
        inputs, outputs = (interface.of(causality) for causality in ("input", "output"))
        own = float(self.values.get("sample_time", interface.ports["sample_time"].start or 0))
        names = tuple(port.name for port in inputs), tuple(port.name for port in outputs)
        direct = d if d.size else np.zeros((len(outputs), len(inputs)))
        units = {port.name: port.unit for port in (*inputs, *outputs) if port.unit}
        return LinearPlant(LinearModel(a, b, c, direct, own, *names), units)


@dataclass(frozen=True, eq=False)
class GivenPlant:
    """Matrices that the study holds."""

    plant: LinearPlant

    def linear(self, place: str, step: float) -> LinearPlant:
        """The same."""
        return self.plant


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
