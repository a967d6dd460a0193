"""A scenario in the units of its system: recordings that drive inputs, and references, converted where they differ."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.assembly.stimulus import brought
from orchestrator.assembly.whole_arrays import all_elements
from orchestrator.crossing import Crossing
from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations import Above, Below, Condition, Expectation, Near, Refusal, Unread
from orchestrator.scenario.scenario import Scenario
from orchestrator.system import Endpoint, System
from orchestrator.trace import Trace


def in_units_of(system: System, scenario: Scenario) -> tuple[Scenario, list[Crossing]]:
    """The scenario with its recordings in the units of the variables that they go to, and how they got there; whole
    arrays that are to be recorded by their elements.

    Raises:
        WiringError: units of different quantities, or an expectation of a variable that there is not.
    """
    crossed: list[Crossing] = []

    def expected(asked: Expectation | Refusal) -> Expectation | Refusal:
        if isinstance(asked, Refusal):
            return asked
        place = f"expect {asked.signal}"
        port, condition = system.port(Endpoint.parse(asked.signal, place), place), asked.condition
        if isinstance(condition, Near) and isinstance(condition.target, Trace):
            target, how = brought(condition.target, place, port, condition.given)
            crossed.append(how)
            condition = replace(condition, target=target)
        return replace(asked, condition=_in_numbers(condition, place, port))

    stimuli = {}
    for name, stimulus in scenario.stimuli.items():
        stimuli[name], how = stimulus.brought(name, system.port(Endpoint.parse(name)))
        crossed += [] if how is None else [how]
    shared = {id(asked): asked for case in scenario.cases for asked in case.expected}
    done = {key: expected(asked) for key, asked in shared.items()}  # once each: a reference may be large
    cases = tuple(replace(case, expected=tuple(done[id(a)] for a in case.expected)) for case in scenario.cases)
    record = None if scenario.record is None else all_elements(system, scenario.record)
    return replace(scenario, stimuli=stimuli, cases=cases, record=record), crossed


def _in_numbers(condition: Condition, place: str, port: Port) -> Condition:
    """The condition with what it says like `90 deg` in the unit of the variable; `within` is a difference."""
    if isinstance(condition, Near) and isinstance(condition.target, str):
        condition = replace(condition, target=port.quantity(place, condition.target))
    if isinstance(condition, Near | Unread):
        if isinstance(condition.within, str):
            condition = replace(condition, within=port.quantity(place, condition.within, difference=True))
    elif isinstance(condition, Below | Above) and isinstance(condition.limit, str):
        condition = replace(condition, limit=port.quantity(place, condition.limit))
    return condition
