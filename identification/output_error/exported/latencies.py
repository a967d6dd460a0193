"""Latencies that a study found or was given, as components that bring them to whoever runs the result.

A command that comes late goes through a `delay` of the library before its input, a reading that comes late through one
behind its output; see `fmus.models.signals.delay`. What no component can do is told.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fmus.packaging import targets
from identification.estimation.groups import own_values
from identification.method import CalibratedFmu
from identification.output_error.calibration import Calibration
from identification.output_error.times.delays import Delay
from orchestrator.system import Endpoint


@dataclass(frozen=True)
class Latency:
    """What comes late, and by how much.

    Attributes:
        end: component.variable, an input that is commanded or an output that is read.
        component: the one that brings it.
        seconds: how much later [s]; of several groups of recordings that of the first, as FMUs have it.
        own: the same in the first window.
        command: whether it is of an input.
        obstacle: why no component can bring it; nothing where one can.
    """

    end: str
    component: str
    seconds: float
    own: float
    command: bool
    obstacle: str = ""

    @property
    def verb(self) -> str:
        """What is done to the end."""
        return "driven" if self.command else "read"

    @property
    def outside(self) -> str:
        """component.variable that others drive or read in place of the end."""
        return f"{self.component}.{'signal' if self.command else 'late'}"

    @property
    def links(self) -> tuple[str, ...]:
        """How the component is connected to the end."""
        if self.command:
            return (f"{self.component}.late -> {self.end}",)
        return (f"{self.end} -> {self.component}.signal",)


def latencies(calibration: Calibration) -> tuple[Latency, ...]:
    """All that are not 0."""
    taken = set(calibration.study.system.components)
    found = []
    for end, delay, command, stepwise in _late(calibration):
        known = [delay.at(values) for values in _values(calibration)]
        if any(known):
            component = _name(end, taken)
            taken.add(component)
            obstacle = _obstacle(min(known), stepwise)
            found.append(Latency(end, component, known[0], known[-1], command, obstacle))
    return tuple(found)


def _values(calibration: Calibration) -> list[dict[str, float]]:
    """Parameters as the groups of recordings have them, from the first on, and at last those of the first window."""
    grouped, found = calibration.study.grouped, calibration.estimate.values
    first = {**found, **{one.variable: found[next(iter(one.members.values()))] for one in grouped}}
    others = [{one.variable: found[member]} for one in grouped for member in one.members.values()]
    own = own_values(grouped, calibration.train.windows[0].trace, found)
    return [first, *({**first, **other} for other in others), own]


def _late(calibration: Calibration) -> Iterator[tuple[str, Delay, bool, bool]]:
    """Ends, how late they are, whether they are inputs, and whether they change in steps."""
    for end, command in calibration.train.windows[0].commands.items():
        yield end, command.delay, True, command.stepwise
    for end, spec in calibration.study.run.outputs.items():
        if spec.delay is not None:
            yield end, spec.delay, False, not calibration.system.port(end).real


def _obstacle(seconds: float, stepwise: bool) -> str:
    if seconds < 0:
        return "nothing can act before it is told: shift what is recorded by as much"
    return "it changes in steps, between which it has no values: shift what is recorded by as much" if stepwise else ""


def _name(end: str, taken: set[str]) -> str:
    point = Endpoint.parse(end)
    plain = "".join(one if one.isalnum() else "_" for one in f"{point.component}_{point.variable}_delay")
    return next(name for name in (plain, *(f"{plain}_{i}" for i in range(2, 99))) if name not in taken)


def latency_notes(calibration: Calibration) -> list[str]:
    """A sentence about each that stays behind."""
    return [
        f"{one.end} is {one.verb} {one.seconds:.4g} s late, which stays in the result: {one.obstacle}"
        for one in latencies(calibration)
        if one.obstacle
    ]


def latency_fmus(calibration: Calibration, folder: Path) -> Mapping[str, CalibratedFmu]:
    """component -> the FMU that brings a latency, built into a folder, with its values."""
    step = float(calibration.study.run.step)
    return {
        one.component: CalibratedFmu(
            targets.build("delay", folder / f"{one.component}.fmu"),
            {"delay": one.seconds, "shape": "held" if one.command else "smooth"},
            step,
        )
        for one in latencies(calibration)
        if not one.obstacle
    }
