"""What each component of a system comes to at a point, found by the best that it offers; and what only drives others.

In this order: the matrices of a `state_space` FMU, directional derivatives (or differences) of Model Exchange, tangents
of FMUs of the library, differences of the equations of a library model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fmus import library
from fmus.errors import IdentificationError
from fmus.modelling.model import Model
from identification.linear.fmu import model_in
from identification.linearisation import equations
from identification.linearisation.fmu_sampling import Stopped, fmu_gains, fmu_sampling
from identification.linearisation.fmu_slopes import fmu_slopes
from identification.linearisation.point import OperatingPoint
from identification.linearisation.slopes import MATRICES, Sampling, Slopes, Standing
from orchestrator.assembly.assembly import ComponentSpec, model_of
from orchestrator.fmi.file import FmuDescription, FmuKind
from orchestrator.fmi.interface import Interface, Value
from orchestrator.fmi.slave import Slave


@dataclass
class Parts:
    """What components come to.

    Attributes:
        between: in continuous time.
        at_instants: where they sample; of what only passes on, what it does in between.
        sources: those that are driven by nothing and have no states.
        by: component -> what it was linearised by.
    """

    between: dict[str, Slopes] = field(default_factory=dict)
    at_instants: dict[str, Sampling] = field(default_factory=dict)
    sources: list[str] = field(default_factory=list)
    by: dict[str, str] = field(default_factory=dict)

    @property
    def periods(self) -> dict[str, float]:
        """component -> sample period, of those that have one [s]."""
        return {name: part.period for name, part in self.at_instants.items() if part.period > 0}

    def add(
        self, name: str, spec: ComponentSpec, file: FmuDescription, values: Mapping[str, Value], at: OperatingPoint
    ) -> None:
        """Take a component in.

        Args:
            spec: what it is made of.
            values: variable -> what it was given.

        Raises:
            IdentificationError: it cannot be linearised there; the message says why.
            FmuError: its FMU fails.
        """
        interface = file.interface
        standing = _standing(name, interface, at)
        if interface.model_name == "state_space" and interface.shape("A") is not None:
            model = model_in(interface, name, values)
            matrices = model.a, model.b, model.c, model.d
            self._take(name, None, Sampling(*matrices, model.inputs, model.outputs, model.step, MATRICES))
        elif not standing.inputs and not file.state_names:
            self.sources.append(name)
        elif FmuKind.MODEL_EXCHANGE in file.kinds:
            _require_seen(name, file, standing)
            self._take(name, fmu_slopes(name, file.path, values, at=standing), None)
        else:
            self._take(name, *_stepped(name, spec, interface, standing, at))

    def _take(self, name: str, between: Slopes | None, sampled: Sampling | None) -> None:
        if between is not None:
            self.between[name], self.by[name] = between, between.by
        if sampled is not None:
            self.at_instants[name], self.by[name] = sampled, sampled.by


def _stepped(
    name: str, spec: ComponentSpec, interface: Interface, standing: Standing, at: OperatingPoint
) -> tuple[Slopes | None, Sampling | None]:
    """What a component without Model Exchange does."""
    _require_prompt(name, spec, interface, at)
    component, mixed = at.components[name], _mixed(interface)
    period = at.before.get(f"{name}.sample_time")
    outputs = [port.name for port in interface.of("output") if port.real]
    if not mixed and name in at.saved and isinstance(component, Slave):
        stopped = Stopped(component, at.saved[name], float(at.time), dict(standing.inputs))
        if period is not None:
            return None, fmu_sampling(name, stopped, outputs, period)
        gains = fmu_gains(name, stopped, outputs)
        return gains, _at_instants(gains)
    if spec.fmu is not None:
        fix = "ask its supplier for Model Exchange, or identify a linear model of it (`method: subspace`)"
        problem = "has no Model Exchange and carries no tangents, one of which would tell its slopes"
        if mixed:
            problem, fix = "has states in continuous time and samples, too", "name its `model` in place of its FMU"
        raise IdentificationError(name, problem, fix)
    model = model_of(spec)
    _require_shown(name, model, interface, at)
    given = {variable.name: at.before[f"{name}.{variable.name}"] for variable in model.of("parameter")}
    known = {state.name: standing.states[state.name] for state in model.states if state.name in standing.states}
    shown = replace(standing, states=known)
    if model.update is None:
        return equations.slopes(name, model, given, at=shown), None
    assert model.sample_time is not None
    return equations.sampling(name, model, given, float(given[model.sample_time]), shown)


def _require_prompt(name: str, spec: ComponentSpec, interface: Interface, at: OperatingPoint) -> None:
    """See that no input acts late, which takes more states than there are."""
    known = library.find(interface.model_name) if interface.model_name in library.names() else None
    model = model_of(spec) if spec.fmu is None else known
    for delay in model.delays if model else ():
        if at.before.get(f"{name}.{delay.seconds}", 0.0):
            problem = f"'{delay.input}' acts late, which no linear model of finite order does"
            raise IdentificationError(f"{name}.{delay.seconds}", problem, "set it to 0 here, and add it by a margin")


def _standing(name: str, interface: Interface, at: OperatingPoint) -> Standing:
    """Where a component is: the numbers that it had before the step, and the inputs of the step."""
    own = {port: at.before[f"{name}.{port}"] for port in interface.ports if f"{name}.{port}" in at.before}
    inputs = {port.name: at.after[f"{name}.{port.name}"] for port in interface.of("input") if port.real}
    return Standing(float(at.time), own, inputs)


def _at_instants(gains: Slopes) -> Sampling:
    """What passes on without delay, as it does where others sample."""
    d = gains.d[0]
    nothing = np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((len(d), 0))
    return Sampling(*nothing, d, gains.inputs, gains.outputs, 0.0, gains.by)


def _mixed(interface: Interface) -> bool:
    """Whether it has states of its own in continuous time, which it does not offer to a solver."""
    return any(port.causality == "local" and port.variability == "continuous" for port in interface.ports.values())


def _require_seen(name: str, file: FmuDescription, standing: Standing) -> None:
    hidden = [state for state in file.state_names if state not in standing.states]
    if hidden:
        problem = f"does not show its state '{hidden[0]}'"
        raise IdentificationError(name, problem, "ask its supplier for one whose states are variables")


def _require_shown(name: str, model: Model, interface: Interface, at: OperatingPoint) -> None:
    """See that all states can be read, or are where they start."""
    hidden = [state.name for state in model.states if state.name not in interface.ports]
    if hidden and at.steps:
        problem = f"its FMU does not show its state '{hidden[0]}'"
        raise IdentificationError(name, problem, "linearise at the start, or where there is a C compiler")
