"""Values that are changed while a run goes on: between two steps, read back, and kept as what became of them.

What can be changed are tunable parameters, and inputs that nothing drives. The record has a column of each, in which a
change holds from the row on that the step begins at.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.errors import WiringError
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Port, Value
from orchestrator.settable import check_bounds
from orchestrator.system import Endpoint, System, drivable
from orchestrator.trace import Trace


@dataclass(frozen=True)
class ValueChange:
    """A value that was changed.

    Attributes:
        time: of the step's beginning from which on it holds [s].
        step: number of that step.
        name: component.variable.
        before, value: what it had, and what it has, as its FMU says [unit of the variable].
        asked: what it was to have.
        by: who asked for it.
    """

    time: float
    step: int
    name: str
    before: Value
    value: Value
    asked: Value
    by: str

    @property
    def taken(self) -> bool:
        """Whether the FMU has it as it was asked for."""
        return self.value == self.asked


def changeable(system: System) -> dict[str, Port]:
    """component.variable -> what can be changed while a run goes on."""
    driven = {link.target for link in system.links} | system.stimulated
    return {
        f"{name}.{port.name}": port
        for name, part in system.parts.items()
        for port in part.interface.ports.values()
        if port.numeric and Endpoint(name, port.name) not in driven
        if port.causality == "input" or (port.causality == "parameter" and port.variability == "tunable")
    }


class Tuned:
    """The values of a run that can be changed.

    Attributes:
        ports: component.variable -> its variable.
        values: what they have now; nothing before the run has begun.
        changes: what was changed.

    Raises:
        WiringError: a name is of nothing that can be changed while a run goes on.
    """

    def __init__(self, system: System, components: Mapping[str, Component], names: Iterable[str] | None) -> None:
        known = changeable(system)
        for name in names or ():
            if name not in known:
                drivable(system, Endpoint.parse(name), "can be changed while it runs")
                raise WiringError(name, "is driven by something else", "change what drives it")
        self.ports = known if names is None else {name: known[name] for name in names}
        self.values: dict[str, Value] = {}
        self.changes: list[ValueChange] = []
        self._components = components
        self._recorded: dict[str, float] = {}  # at the end of the record so far
        self._later: dict[str, list[ValueChange]] = {}  # those that are not in it

    def begin(self) -> None:
        """Take note of what they have at the beginning of a run."""
        for name in self.ports:
            end = Endpoint.parse(name)
            self.values[name] = self._components[end.component].get(end.variable)
        self._recorded = {name: float(value) for name, value in self.values.items()}

    def checked(self, name: str, value: Value) -> Value:
        """The value in the variable's type and unit.

        Raises:
            WiringError: nothing of that name can be changed, or the value is out of bounds.
            FmuFileError: it is of another type.
        """
        if name not in self.ports:
            raise WiringError(name, "cannot be changed", f"there are {', '.join(self.ports) or 'none'}")
        port = self.ports[name]
        typed = port.typed(name, value)
        if not isinstance(typed, str):
            check_bounds(name, port, typed)
        return typed

    def change(self, name: str, value: Value, step: int, time: float, by: str) -> ValueChange:
        """Give it a checked value from this step on, and note what came of it.

        Raises:
            FmuError: its FMU refuses.
        """
        end = Endpoint.parse(name)
        taken = self._components[end.component].tune(end.variable, value)
        made = ValueChange(time, step, name, self.values[name], taken, value, by)
        self.values[name] = taken
        self.changes.append(made)
        self._later.setdefault(name, []).append(made)
        return made

    def beside(self, piece: Trace) -> Trace:
        """The next piece of the record, with a column of each."""
        if not self.ports:
            return piece
        signals = dict(piece.signals)
        for name in self.ports:
            later = self._later.pop(name, [])
            values = np.array([self._recorded[name], *(float(change.value) for change in later)])
            passed = np.searchsorted([change.time for change in later], piece.time, side="right")
            signals[name] = values[passed]
            done = int(passed[-1])
            self._recorded[name] = values.item(done)
            if later[done:]:
                self._later[name] = later[done:]
        units = {name: port.unit for name, port in self.ports.items() if port.unit}
        return Trace(piece.time, signals, {**piece.units, **units}, piece.name, piece.texts)
