"""A scenario as a file of the suite: an FMU that fails, crashes or takes too much costs its case, and no other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fmus.errors import FmuError
from orchestrator.fmi.isolation import Isolation
from orchestrator.fmi.said import LOG_FILE
from orchestrator.results import FileDocument, aside
from orchestrator.scenario.results import document_of, write_run
from orchestrator.scenario.run import CaseResult, CaseState, Keeping, ScenarioResult, run_scenario
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario

SHARED = "../.."  # the suite's folder, as seen from one of its results


@dataclass(frozen=True)
class LostCase:
    """A case whose process had to be killed, or died.

    Attributes:
        seconds: wall time until then [s].
    """

    problem: str
    fix: str
    seconds: float

    def error(self, place: object) -> FmuError:
        """As the error of a case, or of a file."""
        return FmuError(place, self.problem, self.fix)


@dataclass(frozen=True)
class ScenarioJudge:
    """Runs a scenario's cases and writes its folder of results.

    Attributes:
        isolation: how FMUs that scenarios give as files are isolated, None where they are not.
        lost: number of a case -> what became of it when it was tried; it is not tried again.
    """

    isolation: Isolation | None = None
    lost: Mapping[int, LostCase] = field(default_factory=dict)

    def without(self, place: int, case: LostCase) -> ScenarioJudge:
        """One that does not try the case any more that is at this place among those which this one tries."""
        tried = [number for number in range(place + len(self.lost) + 1) if number not in self.lost]
        return replace(self, lost={**self.lost, tried[place]: case})

    def __call__(self, file: Path, out: Path) -> FileDocument:
        """Run the cases, write the folder `out`, and say how they went.

        Raises:
            FmuError: there is no case left to be tried.
            ServotwinError: what `run_scenario` raises, but for a failure of FMUs in a case.
        """
        with aside(out, [file]) as near:
            scenario = load_scenario(file)
            left = tuple(case for number, case in enumerate(scenario.cases) if number not in self.lost)
            if not left:
                first = next(iter(self.lost.values()))
                raise first.error(file if len(self.lost) == 1 else f"{file}: each of {len(self.lost)} cases")
            keeping = Keeping(log=near / LOG_FILE)
            result = run_scenario(
                replace(scenario, cases=left), keeping=keeping, isolation=self.isolation, going_on=True
            )
            result = self._completed(result, scenario)
            write_run(result, {}, out, SHARED)
            return document_of(result, {}, out)

    def _completed(self, result: ScenarioResult, scenario: Scenario) -> ScenarioResult:
        """The result with the cases that are lost, in the order of the file."""
        done = iter(zip(result.cases, result.scenario.cases, strict=True))
        cases: list[CaseResult] = []
        asked: list[Case] = []
        for number, case in enumerate(scenario.cases):
            made, wanted = (_lost(case, self.lost[number]), case) if number in self.lost else next(done)
            cases.append(made)
            asked.append(wanted)
        return replace(result, cases=tuple(cases), scenario=replace(result.scenario, cases=tuple(asked)))


def _lost(case: Case, lost: LostCase) -> CaseResult:
    return CaseResult(
        case.name, None, lost.error(f"case {case.name}"), (), state=CaseState.FAILED, seconds=lost.seconds
    )
