"""What a suite makes of changed parameters: each by scenario, and the share of those that act that is seen."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from orchestrator.batch.verdict import Verdict
from orchestrator.results import CaseDocument

HEADERS: Sequence[str] = ("scenario", "seen", "unseen", "does not act")


class MutationOutcome(StrEnum):
    """What a scenario makes of a parameter that is changed."""

    SEEN = "seen"
    UNSEEN = "unseen"
    WITHOUT_EFFECT = "does not act"


def document(name: str, outcome: MutationOutcome, found: str) -> CaseDocument:
    """A parameter as a case of a document, passed unless it went unseen.

    Args:
        found: how it was changed, and who noticed it how.
    """
    unseen = outcome is MutationOutcome.UNSEEN
    check = {"text": outcome, "held": not unseen, "found": found}
    return {"name": name, "passed": not unseen, "error": None, "checks": [check]}  # type: ignore[list-item]


def outcome_of(case: CaseDocument) -> MutationOutcome:
    """What became of the parameter that a case of such a document is about."""
    return MutationOutcome(case["checks"][0]["text"])


def clearer(one: CaseDocument | None, other: CaseDocument) -> CaseDocument:
    """Of what two systems of a file make of a parameter, what says more: seen, then unseen."""
    order = list(MutationOutcome)
    return other if one is None else min((one, other), key=lambda case: order.index(outcome_of(case)))


@dataclass(frozen=True)
class Coverage:
    """What the scenarios of a suite notice, by (file, parameter).

    Attributes:
        found: how the parameter was changed, and who noticed it how.
    """

    outcomes: Mapping[tuple[Path, str], MutationOutcome]
    found: Mapping[tuple[Path, str], str] = field(default_factory=dict)

    @classmethod
    def of(cls, verdicts: Iterable[Verdict]) -> Coverage:
        """From the verdicts of a `MutationJudge`; files that ended in an error have none."""
        documents = [(verdict.file, verdict.document) for verdict in verdicts if verdict.document is not None]
        cases = {(file, case["name"]): case for file, one in documents for case in one["cases"]}
        return cls(
            {key: outcome_of(case) for key, case in cases.items()},
            {key: case["checks"][0]["found"] for key, case in cases.items()},
        )

    def count(self, outcome: MutationOutcome) -> int:
        """How many changes came out so."""
        return sum(one is outcome for one in self.outcomes.values())

    @property
    def share(self) -> float:
        """Of the changes that act, those that the scenario which they act in notices; 1 where there are none."""
        seen, unseen = self.count(MutationOutcome.SEEN), self.count(MutationOutcome.UNSEEN)
        return seen / (seen + unseen) if seen + unseen else 1.0

    @property
    def sentence(self) -> str:
        """That share, and what it is of."""
        seen, acting = (
            self.count(MutationOutcome.SEEN),
            self.count(MutationOutcome.SEEN) + self.count(MutationOutcome.UNSEEN),
        )
        if not acting:
            return "no change was made that acts: there was nothing to notice"
        return (
            f"{100 * self.share:.1f} % of the changes that act are noticed ({seen} of {acting}; "
            f"{self.count(MutationOutcome.WITHOUT_EFFECT)} change no output by more than the solver is off)"
        )

    @property
    def unseen(self) -> dict[str, list[Path]]:
        """component.parameter -> scenarios that it acts in and that do not notice it."""
        found: dict[str, list[Path]] = defaultdict(list)
        for (file, name), outcome in self.outcomes.items():
            if outcome is MutationOutcome.UNSEEN:
                found[name].append(file)
        return dict(sorted(found.items()))

    @property
    def unnoticed(self) -> dict[str, list[Path]]:
        """component.parameter that no scenario notices -> those that depend on it."""
        seen = {name for (_, name), outcome in self.outcomes.items() if outcome is MutationOutcome.SEEN}
        return {name: files for name, files in self.unseen.items() if name not in seen}

    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """A row under `HEADERS` of each file: how many changes were seen, unseen and without effect."""
        files = dict.fromkeys(file for file, _ in self.outcomes)
        for file in files:
            counts = [sum(o is kind for (f, _), o in self.outcomes.items() if f == file) for kind in MutationOutcome]
            seen, unseen, without = map(str, counts)
            yield str(file), seen, unseen, without
