"""A scenario in the units of its system: recordings that drive inputs, and references, converted where they differ."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.assembly.whole_arrays import all_elements
from orchestrator.crossing import Crossing
from orchestrator.scenario.expectations import ExpectationScope
from orchestrator.scenario.scenario import Scenario
from orchestrator.system import Endpoint, System


def in_units_of(system: System, scenario: Scenario) -> tuple[Scenario, list[Crossing]]:
    """The scenario with its recordings in the units of the variables that they go to, and how they got there; whole
    arrays that are to be recorded by their elements.

    Raises:
        WiringError: units of different quantities, or an expectation of a variable that there is not.
    """
    wiring = ExpectationScope(lambda name, place: system.port(Endpoint.parse(name, place), place))
    stimuli = {}
    for name, stimulus in scenario.stimuli.items():
        stimuli[name], how = stimulus.brought(name, system.port(Endpoint.parse(name)))
        wiring.crossings += [] if how is None else [how]
    shared = {id(asked): asked for case in scenario.cases for asked in case.expected}
    done = {key: asked.brought(wiring) for key, asked in shared.items()}  # once each: a reference may be large
    cases = tuple(replace(case, expected=tuple(done[id(a)] for a in case.expected)) for case in scenario.cases)
    return replace(by_elements(system, scenario), stimuli=stimuli, cases=cases), wiring.crossings


def by_elements(system: System, scenario: Scenario) -> Scenario:
    """The scenario with whole arrays that are to be recorded by their elements.

    Raises:
        WiringError: a name is of no component.
    """
    return replace(scenario, record=None if scenario.record is None else all_elements(system, scenario.record))
