"""Which parameters a suite looks after: each is changed by a little, and the scenarios that depend on it should notice.

A scenario notices a change when one of its cases comes out otherwise; it depends on a parameter when the change shows
in what it records.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from fmus.errors import InputError, ServotwinError
from orchestrator.batch.verdict import Verdict
from orchestrator.fmi.interface import Port, Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.results import CaseDocument, FileDocument
from orchestrator.scenario.run import CaseResult, ScenarioResult, run_scenario
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.system import System
from orchestrator.trace import Trace

SHARE = 0.01  # of its value by which a parameter is changed


class Outcome(StrEnum):
    """What a scenario makes of a parameter that is changed."""

    SEEN = "seen"
    UNSEEN = "unseen"
    WITHOUT_EFFECT = "without effect"


@dataclass(frozen=True)
class MutationJudge:
    """Judges a scenario by what it notices: a case of the document is a parameter, passed unless it went unseen.

    Raises (when called):
        InputError: the scenario does not pass as it is.
        ServotwinError: it cannot be run.
    """

    isolation: Isolation | None = None

    def __call__(self, file: Path, out: Path) -> FileDocument:
        """The document about a file; nothing is written."""
        scenario = load_scenario(file)
        outcomes: dict[str, CaseDocument] = {}
        for group in scenario.by_system():
            plain = run_scenario(group, isolation=self.isolation)
            if not plain.passed:
                raise InputError(file, "does not pass as it is", "mend it, or what it is about, first")
            for name in parameters(plain):
                found = self._tried(group, plain, name)
                outcomes[name] = _clearer(outcomes.get(name), found)
        cases = list(outcomes.values())
        return {"title": scenario.title, "passed": all(case["passed"] for case in cases), "out": "", "cases": cases}

    def _tried(self, scenario: Scenario, plain: ScenarioResult, name: str) -> CaseDocument:
        """What the cases make of one parameter; the first that notices is enough."""
        moved, values = False, list[str]()
        for number, case in enumerate(scenario.cases):
            value = value_of(name, case, plain.system)
            if value is None:
                continue
            changed = _changed(value, _port(plain.system, name))
            values.append(f"{value:g} -> {changed:g}")
            found = self._noticed(scenario, case, {name: changed}, plain.cases[number])
            if isinstance(found, str):
                return _document(name, Outcome.SEEN, f"{values[-1]}: {case.name}: {found}")
            moved = moved or found
        return _document(name, Outcome.UNSEEN if moved else Outcome.WITHOUT_EFFECT, ", ".join(dict.fromkeys(values)))

    def _noticed(self, scenario: Scenario, case: Case, values: Mapping[str, Value], plain: CaseResult) -> str | bool:
        """Why a case does not come out as it did, or whether at least its record differs."""
        mutant = replace(scenario, cases=(replace(case, values={**case.values, **values}),))
        try:
            (made,) = run_scenario(mutant, isolation=self.isolation, going_on=True).cases
        except ServotwinError as error:
            return str(error)
        if made.passed != plain.passed or (made.error is None) != (plain.error is None):
            missed = [f"{check.text}, found {check.found}" for check in made.checks if not check.held]
            return missed[0] if missed else str(made.error)
        return made.result is not None and plain.result is not None and not _equal(made.trace, plain.trace)


def parameters(result: ScenarioResult) -> list[str]:
    """component.parameter of a system whose values are real numbers other than zero in some case."""
    system = result.system
    assert system is not None
    names = [
        f"{component}.{port.name}"
        for component, part in system.parts.items()
        for port in part.interface.ports.values()
        if port.real and port.causality == "parameter" and port.variability != "constant"
    ]
    return [name for name in names if any(value_of(name, case, system) for case in result.scenario.cases)]


def value_of(name: str, case: Case, system: System | None) -> float | None:
    """What a parameter is in a case [its unit]; None where it is zero, or not known."""
    port = _port(system, name)
    given = case.values.get(name, port.start)
    if given is None:
        return None
    try:
        value = float(given)
    except ValueError:
        value = port.quantity(name, str(given))
    return value or None


def _port(system: System | None, name: str) -> Port:
    assert system is not None
    component, _, variable = name.partition(".")
    return system.parts[component].interface.ports[variable]


def _changed(value: float, port: Port) -> float:
    """The value changed by the share, downwards where it would leave its range otherwise."""
    more, less = value * (1 + SHARE), value * (1 - SHARE)
    inside = (port.minimum is None or more >= port.minimum) and (port.maximum is None or more <= port.maximum)
    return more if inside else less


def _equal(one: Trace, other: Trace) -> bool:
    return len(one) == len(other) and all(np.array_equal(one[name], other[name], True) for name in one.names)


def _document(name: str, outcome: Outcome, found: str) -> CaseDocument:
    check = {"text": outcome, "held": outcome is not Outcome.UNSEEN, "found": found}
    return {"name": name, "passed": outcome is not Outcome.UNSEEN, "error": None, "checks": [check]}  # type: ignore[list-item]


def _clearer(one: CaseDocument | None, other: CaseDocument) -> CaseDocument:
    """Of what two systems of a file make of a parameter, what says more: seen, then unseen."""
    order = list(Outcome)
    return other if one is None else min((one, other), key=lambda case: order.index(outcome_of(case)))


def outcome_of(case: CaseDocument) -> Outcome:
    """What became of the parameter that a case of such a document is about."""
    return Outcome(case["checks"][0]["text"])


@dataclass(frozen=True)
class Coverage:
    """What the scenarios of a suite notice, by (file, parameter).

    Attributes:
        found: how the parameter was changed, and who noticed it how.
    """

    outcomes: Mapping[tuple[Path, str], Outcome]
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

    @property
    def share(self) -> float:
        """Of the changes that show in what a scenario records, those that it notices; 1 where there are none."""
        counts = [outcome for outcome in self.outcomes.values() if outcome is not Outcome.WITHOUT_EFFECT]
        return sum(outcome is Outcome.SEEN for outcome in counts) / len(counts) if counts else 1.0

    @property
    def unnoticed(self) -> dict[str, list[Path]]:
        """component.parameter that no scenario notices -> those that depend on it."""
        found: dict[str, list[Path]] = defaultdict(list)
        for (file, name), outcome in self.outcomes.items():
            if outcome is Outcome.UNSEEN:
                found[name].append(file)
        seen = {name for (_, name), outcome in self.outcomes.items() if outcome is Outcome.SEEN}
        return {name: files for name, files in sorted(found.items()) if name not in seen}

    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """A row of each file: how many changes were seen, unseen and without effect."""
        files = dict.fromkeys(file for file, _ in self.outcomes)
        for file in files:
            counts = [sum(o is kind for (f, _), o in self.outcomes.items() if f == file) for kind in Outcome]
            seen, unseen, without = map(str, counts)
            yield str(file), seen, unseen, without


HEADERS: Sequence[str] = ("scenario", "seen", "unseen", "without effect")
