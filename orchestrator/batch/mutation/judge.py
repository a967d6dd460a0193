"""Which parameters a scenario looks after: each is changed by a little, and where that acts it should notice.

A scenario notices a change when one of its cases comes out otherwise; the change acts when it moves an output of a case
by more than the run's own error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from pathlib import Path

from fmus.errors import InputError, ServotwinError
from orchestrator.batch.mutation.coverage import MutationOutcome, clearer, document
from orchestrator.batch.mutation.effect import acts
from orchestrator.batch.mutation.parameters import MutatedValue, changed, parameters, value_of
from orchestrator.engine import Timing
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.results import CaseDocument, FileDocument
from orchestrator.scenario.run import CaseResult, CaseState, run_scenario
from orchestrator.scenario.scenario import Case, Scenario
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

    A change that is noticed in the first seconds of a case would be in all of it; so a case is first run up to where
    some of its expectations look no further.

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

    @property
    def _order(self) -> list[int]:
        """Numbers of the cases, those first that are held against what was accepted: they notice most."""
        cases = self._judged.cases
        return sorted(range(len(cases)), key=lambda number: not any(asked.accepted for asked in cases[number].expected))

    def outcome(self, name: str) -> CaseDocument:
        """What the cases make of one parameter; the first that notices is enough."""
        if name in self._seen:
            return document(name, MutationOutcome.SEEN, self._seen[name])
        changes = [change for number in self._order if (change := self._change(name, number))]
        outcome = MutationOutcome.UNSEEN if name in self._acting else MutationOutcome.WITHOUT_EFFECT
        return document(name, outcome, ", ".join(dict.fromkeys(map(str, changes))))

    def _change(self, name: str, number: int) -> MutatedValue | None:
        """How a parameter is changed in a case; None where it is zero there."""
        value = value_of(name, self._judged.cases[number], self.plain.system)
        return None if value is None else MutatedValue(value, changed(name, value, self.plain.system))

    def _look(self, number: int) -> None:
        """See which of the changes that no case has noticed so far this one does, in ever more of it, and which of the
        others move an output by more than it is off."""
        for stop in parts(self._judged.cases[number], self._judged.timing):
            for name, made in self._made(self._judged.until(stop), number):
                self._notice(name, number, made)
        for name, made in self._made(self._shown, number):
            self._notice(name, number, made)
            if name not in self._seen and name not in self._acting and self._acts(number, made):
                self._acting.add(name)

    def _notice(self, name: str, number: int, made: CaseResult) -> None:
        if why := self._otherwise(number, made):
            self._seen[name] = f"{self._change(name, number)}: {made.name}: {why}"

    def _made(self, scenario: Scenario, number: int) -> Iterator[tuple[str, CaseResult]]:
        """What becomes of a case with each of the changes that nothing has noticed so far."""
        left = [
            (name, change) for name in self.names if name not in self._seen and (change := self._change(name, number))
        ]
        for first in range(0, len(left), TOGETHER):
            some = left[first : first + TOGETHER]
            made = self._run(scenario, number, [{name: change.new} for name, change in some])
            yield from zip((name for name, _ in some), made, strict=True)

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
            finer = replace(self._shown, timing=self._shown.timing.finer(2))
            (made,) = self._run(finer, number, [{}])
            self._halved[number] = None if made.result is None else made.trace
        return self._halved[number]

    def _run(self, scenario: Scenario, number: int, values: Sequence[Mapping[str, Value]]) -> Sequence[CaseResult]:
        """A case once with each of these values over its own; one that cannot be run so has failed."""
        case = scenario.cases[number]
        mutants = tuple(replace(case, values={**case.values, **one}) for one in values)
        try:
            return run_scenario(replace(scenario, cases=mutants), isolation=self._isolation, going_on=True).cases
        except ServotwinError as error:
            if len(values) > 1:
                return [made for one in values for made in self._run(scenario, number, [one])]
            return [CaseResult(case.name, None, error, (), state=CaseState.FAILED)]


def parts(case: Case, timing: Timing) -> list[Fraction]:
    """Until when a case is run to know whether what it is asked up to there holds: ever longer, each at least twice as
    long as the one before, and the whole as the last [s]; none where a part might go otherwise than the whole does."""
    if case.may_be_refused or timing.tell_stop:
        return []
    ends = {asked.until for asked in case.expected if asked.until < timing.stop}
    steps = sorted({ceil((Fraction(end) - timing.start) / timing.step) for end in ends}, reverse=True)
    chosen = [(timing.stop - timing.start) / timing.step]
    for count in steps:
        if 0 < 2 * count <= chosen[-1]:
            chosen.append(Fraction(count))
    return [timing.start + count * timing.step for count in reversed(chosen[1:])]
