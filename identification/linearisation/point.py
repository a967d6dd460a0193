"""The point about which a system is linearised: its run, stopped at an instant before the next step is taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from fmus.errors import FmuError, WiringError
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.progress import Progress
from orchestrator.rational import multiples, written
from orchestrator.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A run that was stopped at an instant, and what it takes and gives there.

    Attributes:
        time: [s].
        steps: communication steps from the start to it.
        components: as they are after the step from there; `saved` goes back to before it, where they can.
        before: component.variable -> number that it had before the step.
        after: component.variable -> number from that instant on, of inputs and outputs.
    """

    time: Fraction
    steps: int
    components: Mapping[str, Component]
    saved: Mapping[str, Any]
    before: Mapping[str, float]
    after: Mapping[str, float]


def checked(scenario: Scenario, at: Fraction) -> Fraction:
    """The instant, which lies in the run.

    Raises:
        WiringError: it does not, or is no instant of it.
    """
    timing = scenario.timing
    if not timing.start <= at <= timing.stop:
        span = f"{written(timing.start)} to {written(timing.stop)} s"
        raise WiringError("--at", f"{written(at)} s is outside of the run, {span}", "choose an instant of it")
    if at > timing.start:
        multiples(at - timing.start, timing.step, "--at")
    return at


@contextmanager
def reached(
    scenario: Scenario, simulation: Simulation, values: Mapping[str, Value], at: Fraction, progress: Progress
) -> Iterator[OperatingPoint]:
    """The point that a scenario's run with these values comes to at an instant.

    Raises:
        FmuError: an FMU failed before.
    """
    timing = simulation.timing
    steps = int((at - timing.start) / timing.step)
    instants = simulation.instants()[: steps + 1]
    stimuli = {name: stimulus.values(instants, name) for name, stimulus in scenario.stimuli.items()}
    first = {name: samples[:1] for name, samples in stimuli.items()}
    live = simulation.live(Run(values, first, record=()), simulation.outputs, lambda piece: None)

    def step(number: int) -> None:
        for place, name in enumerate(live.inputs):
            live.given[place] = stimuli[name][number]
        live.step()

    for number in range(steps):
        step(number)
        progress(number / (steps + 1), "to the point")
    before = dict(_numbers(simulation))
    saved = {name: component.save() for name, component in simulation.components.items() if _carries(component)}
    try:
        step(steps)
        after = dict(_numbers(simulation, ("input",)))
        after |= dict(zip(live.names, live.outputs, strict=True))
        yield OperatingPoint(at, steps, simulation.components, saved, before, after)
    finally:
        for name, state in saved.items():
            simulation.components[name].drop(state)


def _numbers(simulation: Simulation, causalities: tuple[str, ...] = ()) -> Iterator[tuple[str, float]]:
    """component.variable and value, of what is a number and can be read."""
    for name, component in simulation.components.items():
        for port in component.interface.ports.values():
            if port.numeric and (not causalities or port.causality in causalities):
                try:
                    yield f"{name}.{port.name}", float(component.get(port.name))
                except FmuError:  # whoever needs it will miss it, and say so
                    continue


def _carries(component: Component) -> bool:
    return isinstance(component, Slave) and component.carries
