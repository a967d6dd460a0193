"""What a summary takes of a tuning, whether of linear loops or of simulated ones."""

from __future__ import annotations

from typing import Protocol

from identification.method import CalibratedFmu
from identification.tuning.procedures.procedure import Found
from orchestrator.fmi.interface import Interface
from orchestrator.scenario.run import ScenarioResult


class Titled(Protocol):
    """A study."""

    @property
    def title(self) -> str: ...


class TuningOutcome(Protocol):
    """What a tuning gave, of linear loops or of simulated ones; see `tuning.Tuning`."""

    @property
    def study(self) -> Titled: ...

    @property
    def found(self) -> Found: ...

    @property
    def rigs(self) -> tuple[ScenarioResult, ...]: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def interface(self) -> Interface: ...

    @property
    def remarks(self) -> list[str]: ...

    @property
    def values(self) -> dict[str, float]: ...

    @property
    def controller(self) -> CalibratedFmu: ...
