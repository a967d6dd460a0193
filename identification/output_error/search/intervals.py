"""95 % intervals that rest on fits of their own, and not on the sensitivities at the estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from identification.output_error.search.options import BootstrapKind, IntervalBy
from identification.output_error.search.profile_curve import CostProfile
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Bootstrap(ReadOnlyArrays):
    """Estimates from windows drawn with replacement.

    Attributes:
        names: the free parameters.
        replicates: (B, n) their estimates [unit each].
        failed: fits that did not come to an end, which are left out.
        kind: of the intervals: bca, or percentile where that cannot be had.
    """

    KEYS = ("resamples", "failed", "seed", "kind", "std")

    names: tuple[str, ...]
    replicates: FloatArray
    failed: int
    seed: int
    kind: BootstrapKind

    @property
    def resamples(self) -> int:
        """Fits that were made."""
        return len(self.replicates) + self.failed

    @property
    def std(self) -> dict[str, float]:
        """Name -> standard deviation of its estimates [unit]."""
        return dict(zip(self.names, self.replicates.std(axis=0, ddof=1).tolist(), strict=True))


@dataclass(frozen=True)
class Intervals:
    """Intervals by name, over the local ones.

    Attributes:
        ends: name -> interval [unit]; infinite on an open side.
        profiles: name -> the curve that it is read off.
        bootstrap: the estimates that they come from.
        remarks: what a reader of them must know.
    """

    by: IntervalBy = "local"
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    profiles: Mapping[str, CostProfile] = field(default_factory=dict)
    bootstrap: Bootstrap | None = None
    remarks: tuple[str, ...] = ()


LOCAL = Intervals()
