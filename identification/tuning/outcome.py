"""What a tuning gave, whether of linear loops or of simulated ones, and what rigs say of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

from identification.built_system import BuiltSystem
from identification.method import CalibratedFmu
from identification.tuning.procedures.procedure import Found
from identification.tuning.rig import Rig
from identification.tuning.study import CONTROLLER
from orchestrator.fmi.interface import Interface
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.scenario.run import ScenarioResult
from orchestrator.system import dotted_values


class TuningAsked(Protocol):
    """A study."""

    @property
    def title(self) -> str: ...

    @property
    def rigs(self) -> tuple[Rig, ...]: ...


@dataclass(frozen=True, eq=False)
class TuningOutcome(ABC):
    """What a study gave.

    Attributes:
        built: the controller's FMU, with the study's values.
        interface: of the controller.
        rigs: how the controller did in the scenarios on which the study has it judged.
    """

    study: TuningAsked
    built: BuiltSystem
    interface: Interface
    found: Found
    rigs: tuple[ScenarioResult, ...] = field(default=(), kw_only=True)

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Of the plants."""

    @property
    @abstractmethod
    def remarks(self) -> list[str]:
        """What a reader of the figures must know."""

    @property
    def values(self) -> dict[str, float]:
        """controller.parameter -> value that was found."""
        return dotted_values(CONTROLLER, self.found.best.values)

    @property
    def controller(self) -> CalibratedFmu:
        """The controller's FMU with the study's values and those that were found."""
        return self.built.calibrated(self.values)[CONTROLLER]

    def on_rigs(self, progress: Progress, isolation: Isolation | None) -> Self:
        """The same, judged on the study's rigs."""
        values, rigs = self.found.best.values, self.study.rigs
        return replace(self, rigs=tuple(rig.judged(self.controller, values, progress, isolation) for rig in rigs))
