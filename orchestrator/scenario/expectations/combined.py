"""Several expectations as one: all, any, at least some of them; or some that only warn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from orchestrator.scenario.expectations.base import Check, Draws, ExpectationScope, Expected, Ran
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class AtLeast(Expected):
    """So many of some expectations hold.

    Attributes:
        words: what that is called.
        needed: whether the case fails where they do not; else that is a warning.
    """

    least: int
    parts: tuple[Expected, ...]
    words: str
    needed: bool = True

    def __str__(self) -> str:
        return f"{self.words}: {'; '.join(map(str, self.parts))}"

    @property
    def signals(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(signal for part in self.parts for signal in part.signals))

    @property
    def until(self) -> float:
        return max(part.until for part in self.parts)

    @property
    def refuses(self) -> bool:
        return any(part.refuses for part in self.parts)

    @property
    def files(self) -> tuple[Path, ...]:
        return tuple(dict.fromkeys(file for part in self.parts for file in part.files))

    @property
    def leaves(self) -> tuple[Expected, ...]:
        return tuple(leaf for part in self.parts for leaf in part.leaves)

    @property
    def drawn(self) -> tuple[tuple[str, Draws], ...]:
        return tuple(wanted for part in self.parts for wanted in part.drawn)

    def brought(self, wiring: ExpectationScope) -> Self:
        return replace(self, parts=tuple(part.brought(wiring) for part in self.parts))

    def check_covered(self, instants: FloatArray) -> None:
        for part in self.parts:
            part.check_covered(instants)

    def check(self, ran: Ran) -> Check:
        parts = tuple(part.check(ran) for part in self.parts)
        count = sum(not part.failed for part in parts)
        told = "; ".join(f"{'' if part.held else 'NOT '}{part.found}" for part in parts)
        return Check(
            str(self),
            count >= self.least,
            told if len(parts) == 1 else f"{count} of {len(parts)}: {told}",
            float(count),
            float(count - self.least),
            needed=self.needed,
            doubt="; ".join(part.doubt for part in parts if part.doubt),
            parts=parts,
        )
