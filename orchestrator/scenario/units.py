"""A scenario in the units of its system: recordings that drive inputs, and references, converted where they differ."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.assembly.stimulus import brought
from orchestrator.crossing import Crossing
from orchestrator.scenario.expectations import Expectation, Near, Refusal
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.system import Endpoint, System
from orchestrator.trace import Trace


def in_units_of(system: System, scenario: Scenario) -> tuple[Scenario, list[Crossing]]:
    """The scenario with its recordings in the units of the variables that they go to, and how they got there.

    Raises:
        WiringError: units of different quantities, or an expectation of a variable that there is not.
    """
    crossed: list[Crossing] = []

    def expected(asked: Expectation | Refusal) -> Expectation | Refusal:
        if isinstance(asked, Refusal) or not isinstance(asked.condition, Near):
            return asked
        near = asked.condition
        if not isinstance(near.target, Trace):
            return asked
        port = system.port(Endpoint.parse(asked.signal), f"expect {asked.signal}")
        target, how = brought(near.target, f"expect {asked.signal}", port, near.given)
        crossed.append(how)
        return replace(asked, condition=replace(near, target=target))

    def case_of(case: Case) -> Case:
        return replace(case, expected=tuple(map(expected, case.expected)))

    stimuli = {}
    for name, stimulus in scenario.stimuli.items():
        stimuli[name], how = stimulus.brought(name, system.port(Endpoint.parse(name)))
        crossed += [] if how is None else [how]
    cases = tuple(map(case_of, scenario.cases))
    return replace(scenario, stimuli=stimuli, cases=cases), crossed
