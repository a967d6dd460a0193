"""A scenario with the controller's FMU in it, opened once and run for many values of the controller's parameters."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fmus.errors import IdentificationError, WiringError
from identification.built_system import BuiltSystem
from identification.tuning.simulated.study import LoopSpec
from orchestrator.assembly.assembly import OpenSystem
from orchestrator.engine import Simulation
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import typed
from orchestrator.system import Endpoint, System, dotted_values
from orchestrator.trace import Trace


class SimulatedLoop:
    """A closed loop that is run.

    Attributes:
        system: what runs.
        duration: [s].

    Raises:
        InputError: the scenario has no such case, component or signal, or what it gives does not fit.
    """

    def __init__(
        self,
        place: str,
        spec: LoopSpec,
        controller: Path,
        values: Mapping[str, Value],
        signals: Sequence[str],
        isolation: Isolation | None = None,
    ) -> None:
        self._component, self._signals = spec.component, list(signals)
        there = load_scenario(spec.scenario)
        if spec.component not in there.system.components:
            problem = f"'{spec.component}' is no component of {spec.scenario.name}"
            raise IdentificationError(f"{place}.component", problem, f"there are {', '.join(there.system.components)}")
        scenario = load_scenario(spec.scenario, references=False, fmus={spec.component: controller})
        case = _case(place, scenario, spec)
        system = (case.system or scenario.system).given(spec.values)
        self._built = BuiltSystem(system, scenario.driven)
        opened = OpenSystem(self._built.assembled)
        self.system: System = opened.system
        self.duration = float(scenario.timing.stop - scenario.timing.start)
        self._simulation: Simulation = opened.simulation(scenario.timing, isolation)
        weakref.finalize(self, opened.close)  # and the simulation with it
        scenario, _ = in_units_of(opened.system, replace(scenario, cases=(replace(case, expected=()),)))
        instants = self._simulation.instants()
        self._stimuli = {name: stimulus.values(instants, name) for name, stimulus in scenario.stimuli.items()}
        given = {**case.values, **typed(opened.system, spec.values)}
        self._values = {**given, **dotted_values(spec.component, values)}
        self._simulation.check_values(self._values)
        self._simulation.check_record(self._signals)

    def run(self, values: Mapping[str, float]) -> Trace:
        """What the signals do with these values of the controller's parameters.

        Raises:
            FmuError: an FMU fails, or an output is not finite.
        """
        given = {**self._values, **dotted_values(self._component, values)}
        return self._simulation.run(given, self._stimuli, self._signals).trace

    def unit(self, name: str, place: str) -> str | None:
        """Of a signal.

        Raises:
            WiringError: there is none of this name.
        """
        port = self.system.port(Endpoint.parse(name, place), place)
        if not port.real:
            raise WiringError(place, f"'{name}' is no real number", "name another signal")
        return port.unit


def _case(place: str, scenario: Scenario, spec: LoopSpec) -> Case:
    if spec.case is None:
        return scenario.cases[0]
    found = next((case for case in scenario.cases if case.name == spec.case), None)
    if found is None:
        names = ", ".join(case.name for case in scenario.cases)
        raise IdentificationError(f"{place}.case", f"'{spec.case}' is no case of {spec.scenario.name}", names)
    return found
