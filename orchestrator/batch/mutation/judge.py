"""Which parameters a scenario looks after: each is changed by a little, and where that acts it should notice.

A scenario notices a change when one of its cases comes out otherwise; the change acts when it moves an output of a case
by more than the run's own error.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from fmus.errors import InputError, ServotwinError
from orchestrator.batch.mutation.coverage import Outcome, clearer, document
from orchestrator.batch.mutation.effect import acts
from orchestrator.batch.mutation.parameters import Change, changed, parameters, value_of
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.results import CaseDocument, FileDocument
from orchestrator.scenario.run import CaseResult, run_scenario
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace

TOGETHER = 16  # changes that are run in one go: their records are in memory


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
            probed = _Probed(group, self.isolation)
            for name in probed.names:
                outcomes[name] = clearer(outcomes.get(name), probed.outcome(name))
        cases = list(outcomes.values())
        return {"title": scenario.title, "passed": all(case["passed"] for case in cases), "out": "", "cases": cases}


class _Probed:
    """Cases of one system, run as they are and with parameters changed.

    Raises:
        InputError: they do not pass as they are.
    """

    def __init__(self, scenario: Scenario, isolation: Isolation | None) -> None:
        looked_at = any(case.looked_at for case in scenario.cases)
        self._judged = replace(scenario, record=()) if looked_at else scenario  # what expectations look at
        self._shown = replace(scenario, record=None)  # all outputs
        self._isolation = isolation
        self.plain = run_scenario(self._shown, isolation=isolation)
        if not self.plain.passed:
            raise InputError(scenario.path, "does not pass as it is", "mend it, or what it is about, first")
        self.names = parameters(self.plain)
        self._halved: dict[int, Trace | None] = {}
        self._seen: dict[str, str] = {}
        self._acting: set[str] = set()
        for number in self._order:
            self._look(number)
        for number in self._order:
            self._watch(number)

    @property
    def _order(self) -> list[int]:
        """Numbers of the cases, those first that are held against what was accepted: they notice most."""
        cases = self._judged.cases
        return sorted(range(len(cases)), key=lambda number: not any(asked.accepted for asked in cases[number].expected))

    def outcome(self, name: str) -> CaseDocument:
        """What the cases make of one parameter; the first that notices is enough."""
        if name in self._seen:
            return document(name, Outcome.SEEN, self._seen[name])
        changes = [change for number in self._order if (change := self._change(name, number))]
        outcome = Outcome.UNSEEN if name in self._acting else Outcome.WITHOUT_EFFECT
        return document(name, outcome, ", ".join(dict.fromkeys(map(str, changes))))

    def _change(self, name: str, number: int) -> Change | None:
        """How a parameter is changed in a case; None where it is zero there."""
        value = value_of(name, self._judged.cases[number], self.plain.system)
        return None if value is None else Change(value, changed(name, value, self.plain.system))

    def _look(self, number: int) -> None:
        """See which of the changes that no case has noticed so far this one does."""
        for changes in self._changes(number, self._seen):
            for name, found in self._noticed(number, changes).items():
                self._seen[name] = f"{changes[name]}: {self._judged.cases[number].name}: {found}"

    def _watch(self, number: int) -> None:
        """See which of the changes that no case notices move an output of this one by more than it is off."""
        for changes in self._changes(number, {*self._seen, *self._acting}):
            made = self._run(self._shown, number, [{name: change.new} for name, change in changes.items()])
            self._acting |= {name for name, case in zip(changes, made, strict=True) if self._acts(number, case)}

    def _changes(self, number: int, without: Container[str]) -> Iterator[dict[str, Change]]:
        """How the parameters but these are changed in a case, as many at a time as are run in one go."""
        left = {name: self._change(name, number) for name in self.names if name not in without}
        changes = [(name, change) for name, change in left.items() if change is not None]
        for first in range(0, len(changes), TOGETHER):
            yield dict(changes[first : first + TOGETHER])

    def _noticed(self, number: int, changes: Mapping[str, Change]) -> dict[str, str]:
        """Why a case does not come out as it did, of the changes with which it does not."""
        try:
            made = self._run(self._judged, number, [{name: change.new} for name, change in changes.items()])
        except ServotwinError as error:
            if len(changes) == 1:
                return dict.fromkeys(changes, str(error))
            alone = [self._noticed(number, {name: change}) for name, change in changes.items()]
            return {name: why for found in alone for name, why in found.items()}
        found = {name: self._otherwise(number, case) for name, case in zip(changes, made, strict=True)}
        return {name: why for name, why in found.items() if why}

    def _otherwise(self, number: int, made: CaseResult) -> str:
        """Why a case does not come out as it did, "" where it does."""
        plain = self.plain.cases[number]
        if made.passed == plain.passed and (made.error is None) == (plain.error is None):
            return ""
        missed = [f"{check.text}, found {check.found}" for check in made.checks if not check.held]
        return missed[0] if missed else str(made.error)

    def _acts(self, number: int, made: CaseResult) -> bool:
        """Whether an output of a case has moved by more than the case is off."""
        plain = self.plain.cases[number]
        if made.result is None or plain.result is None or made.trace == plain.trace:
            return False
        return acts(made.trace, plain.trace, self._with_half_the_step(number))

    def _with_half_the_step(self, number: int) -> Trace | None:
        """The case as it is but for its step, None where it cannot be run so."""
        if number not in self._halved:
            timing = self._shown.timing
            finer = replace(self._shown, timing=replace(timing, step=timing.step * Fraction(1, 2)))
            try:
                (made,) = self._run(finer, number, [{}])
            except ServotwinError:
                self._halved[number] = None
            else:
                self._halved[number] = None if made.result is None else made.trace
        return self._halved[number]

    def _run(self, scenario: Scenario, number: int, values: Sequence[Mapping[str, Value]]) -> Sequence[CaseResult]:
        """A case once with each of these values over its own."""
        case = scenario.cases[number]
        mutants = tuple(replace(case, values={**case.values, **one}) for one in values)
        return run_scenario(replace(scenario, cases=mutants), isolation=self._isolation, going_on=True).cases
