"""A design judged on a nonlinear rig before it is written back: its FMU in a scenario whose cases all have to hold."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus.errors import ScenarioError
from fmus.parameters.write_back import write_back
from identification.method import CalibratedFmu
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.results import CaseDocument
from orchestrator.scenario.results import document_of_check
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.system import dotted_values


@dataclass(frozen=True)
class Rig:
    """Where a design is judged.

    Attributes:
        scenario: a scenario file.
        component: of the scenario, in whose place the controller is put.
        gains_only: whether the component stays, and only takes what was found: PDP's gains into PDPC.
        values: component.variable -> value over those of the file.
    """

    scenario: Path
    component: str = "controller"
    gains_only: bool = False
    values: Mapping[str, Value | list[Any]] = field(default_factory=dict)

    def check(self, place: str) -> None:
        """See that the scenario can be read and has the component.

        Raises:
            InputError: it cannot, or has not.
        """
        there = load_scenario(self.scenario).system.components
        if self.component not in there:
            problem = f"'{self.component}' is no component of {self.scenario.name}"
            raise ScenarioError(f"{place}.component", problem, f"there are {', '.join(there)}")

    def judged(
        self,
        controller: CalibratedFmu,
        found: Mapping[str, float],
        progress: Progress,
        isolation: Isolation | None = None,
    ) -> ScenarioResult:
        """All cases with the controller's FMU and its values, or only with those that were `found`.

        References that were accepted of the scenario's own controller judge none of them.

        Raises:
            InputError: it does not fit the scenario.
        """
        with tempfile.TemporaryDirectory(prefix="servotwin-") as folder:
            target = Path(folder) / f"{self.component}.fmu"
            fmus, given = {self.component: target}, dict[str, Value]()
            if self.gains_only:
                fmus, given = {}, dict(found)
            elif target not in write_back(controller.source, controller.values, target):
                fmus, given = {self.component: controller.source}, dict(controller.values)
            values = {**dotted_values(self.component, given), **self.values}
            scenario = load_scenario(self.scenario, references=False, fmus=fmus).without_accepted()
            return run_scenario(scenario, values, progress, isolation=isolation, going_on=True)


def cases(result: ScenarioResult) -> list[CaseDocument]:
    """How the cases of a rig turned out, as plain values."""
    return [
        {
            "name": case.name,
            "passed": case.passed,
            "error": str(case.error) if case.error else None,
            "checks": [document_of_check(check) for check in case.checks],
        }
        for case in result.cases
    ]


def not_held(results: Iterable[ScenarioResult]) -> list[str]:
    """What did not hold, a line a case."""
    lines = []
    for result in results:
        for case in result.cases:
            if not case.passed:
                found = [f"{check.text}: {check.found}" for check in case.checks if check.failed]
                said = "; ".join(found) or str(case.error or case.how_far)
                lines.append(f"{result.scenario.path.name}, {case.name}: {said}")
    return lines
