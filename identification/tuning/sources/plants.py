"""Plants of a study that are linear, sampled models as they come, with the units of their signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from identification.linear.fmu import model_in
from identification.linear.model import LinearModel
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Value


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
        model = model_in(interface, f"{place}: {self.file.name}", self.values)
        inputs, outputs = (interface.of(causality) for causality in ("input", "output"))
        units = {port.name: port.unit for port in (*inputs, *outputs) if port.unit}
        return LinearPlant(model, units)


@dataclass(frozen=True, eq=False)
class GivenPlant:
    """Matrices that the study holds."""

    plant: LinearPlant

    def linear(self, place: str, step: float) -> LinearPlant:
        """The same."""
        return self.plant
