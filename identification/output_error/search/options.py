"""How an estimation searches, and what it tells meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fmus.errors import IdentificationError
from orchestrator.fmi.isolation import Isolation

IntervalBy = Literal["local", "profile", "bootstrap"]
BootstrapKind = Literal["bca", "percentile"]


@dataclass(frozen=True)
class IntervalOptions:
    """How the 95 % intervals of parameters come about.

    Attributes:
        by: local (from the sensitivities at the estimate), profile (the others fitted anew while one is held), or
            bootstrap (all fitted anew to windows drawn with replacement).
        resamples: sets of windows that a bootstrap draws.
        seed: of that drawing.
        kind: which intervals a bootstrap gives: bca (corrected for bias and skewness) or percentile.
    """

    by: IntervalBy = "local"
    resamples: int = 200
    seed: int = 0
    kind: BootstrapKind = "bca"


@dataclass(frozen=True)
class SearchOptions:
    """How the estimation searches.

    Attributes:
        starts: how many start vectors are tried: the declared one, the others spread between the bounds.
        seed: of that spreading.
        start_windows: each start is followed on this many windows only, spread evenly.
        start_iterations: for so many iterations; the best is then continued on all windows.
        max_evaluations: most points tried on all windows.
        cost_tolerance: converged when the cost falls by less than this, relatively.
        step_tolerance: or when no scaled unknown moves by more than this.
        difference_step: relative step of forward differences, about the root of the simulation's accuracy.
        processes: worker processes; 1 simulates in this process.
        isolation: how long a simulation may take; every one runs in a worker process then, which is replaced when it
            crashes or hangs.
        intervals: how the 95 % intervals come about.
    """

    starts: int = 1
    seed: int = 0
    start_windows: int = 6
    start_iterations: int = 8
    max_evaluations: int = 60
    cost_tolerance: float = 1e-5
    step_tolerance: float = 1e-5
    difference_step: float = 1e-4
    processes: int = 1
    isolation: Isolation | None = None
    intervals: IntervalOptions = IntervalOptions()

    def __post_init__(self) -> None:
        for name in ("starts", "start_windows", "start_iterations", "max_evaluations", "processes"):
            if getattr(self, name) < 1:
                raise IdentificationError(f"options.{name}", f"{getattr(self, name)} is too few", "use 1 or more")
        for name in ("cost_tolerance", "step_tolerance", "difference_step"):
            if not 0 < getattr(self, name) < 0.1:
                raise IdentificationError(f"options.{name}", f"{getattr(self, name)} is not within 0 to 0.1")


@dataclass(frozen=True)
class SearchState:
    """Where an estimation stands: stage, iteration within it, cost there, simulations so far, share of the stage."""

    stage: str
    iteration: int
    cost: float
    simulations: int
    share: float = 0.0


Watch = Callable[[SearchState], None]
"""Told where an estimation stands."""
