"""A plant of several components, linearised where they rest; and draws of it from what is known of its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag

from fmus.errors import IdentificationError, WiringError, within
from identification.built_system import BuiltSystem
from identification.linear.model import LinearModel
from identification.linearisation.equations import slopes
from identification.linearisation.fmu_slopes import fmu_slopes
from identification.linearisation.interconnection import ShownOutput, joined
from identification.linearisation.slopes import Slopes
from identification.tuning.sources.plants import LinearPlant
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, model_of
from orchestrator.fmi.interface import Value
from orchestrator.settable import check_values, settable
from orchestrator.system import Endpoint, System, drivable, require
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class PlantOutput:
    """What a plant shows: factor * component.variable.

    Attributes:
        of: component.variable that it shows.
        factor: by which that is multiplied.
        unit: of the output; the variable's without, which a factor leaves unknown.
    """

    of: str
    factor: float = 1.0
    unit: str | None = None


@dataclass(frozen=True, eq=False)
class ParameterSpread:
    """What is known of parameters: covariance about their values.

    Attributes:
        names: component.variable.
        covariance: (n, n) in their units.
    """

    names: tuple[str, ...] = ()
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def draws(
        self, values: Mapping[str, float], bounds: FloatArray, count: int, rng: np.random.Generator
    ) -> FloatArray:
        """(count, n) normal draws about the values, those outside of the bounds (n, 2) drawn again.

        Raises:
            IdentificationError: the covariance is none, or hardly a draw is within the bounds.
        """
        if not np.isfinite(self.covariance).all() or np.linalg.eigvalsh(self.covariance).min(initial=0.0) < -1e-9:
            raise IdentificationError(
                "draws", "the covariance of the parameters is none", "calibrate what is determined"
            )
        middle, found = np.array([values[name] for name in self.names]), np.zeros((0, len(self.names)))
        for _ in range(100):
            drawn = rng.multivariate_normal(middle, self.covariance, size=count, method="eigh")
            inside = ((drawn >= bounds[:, 0]) & (drawn <= bounds[:, 1])).all(axis=1)
            found = np.concatenate([found, drawn[inside]])[:count]
            if len(found) == count:
                return found
        raise IdentificationError("draws", "hardly any lies within the parameters' bounds", "see to their spread")


@dataclass(frozen=True, eq=False)
class SystemPlant:
    """Components and connections, what drives them, and what is seen of them.

    Attributes:
        system: with the values of its components.
        inputs: name -> component.input.
        outputs: name -> what is shown.
        spread: of its parameters; empty where they are known.
    """

    system: SystemSpec
    inputs: Mapping[str, str]
    outputs: Mapping[str, PlantOutput]
    spread: ParameterSpread = field(default_factory=ParameterSpread)

    def linear(self, place: str, step: float) -> LinearPlant:
        """The linear model, sampled every `step` [s].

        Raises:
            InputError: components do not fit together, do not rest, or have no slopes.
        """
        wired = _Wired(place, self)
        [model] = wired.models(step, {}, 1)
        return LinearPlant(model, wired.units, tuple(wired.remarks.values()))

    def value(self, place: str, name: str) -> float | None:
        """Of a real parameter, component.variable; None of another."""
        wired = _Wired(place, self)
        return wired.value(name) if wired.real(name) else None

    def along(self, place: str, step: float, name: str, values: FloatArray) -> list[LinearModel]:
        """Models with these values (K,) of a parameter.

        Raises:
            InputError: as `linear`.
        """
        return _Wired(place, self).models(step, {name: values}, len(values))

    @property
    def uncertain(self) -> bool:
        """Whether something is known of its parameters' spread."""
        return bool(self.spread.names)

    def drawn(self, place: str, step: float, count: int, rng: np.random.Generator) -> list[LinearModel]:
        """Models with parameters drawn from their spread.

        Raises:
            InputError: as `linear`; or a drawn parameter is not there.
        """
        wired = _Wired(place, self)
        bounds = np.array([wired.bounds(name) for name in self.spread.names]).reshape(-1, 2)
        values = {name: wired.value(name) for name in self.spread.names}
        draws = self.spread.draws(values, bounds, count, rng)
        return wired.models(step, dict(zip(self.spread.names, draws.T, strict=True)), count)


class _Wired:
    """The plant's components, checked and wired as any system's."""

    def __init__(self, place: str, plant: SystemPlant) -> None:
        self._place, self._plant = place, plant
        self.remarks: dict[str, str] = {}
        with within(place):
            self._built = BuiltSystem(plant.system, sorted(plant.inputs.values()))
        with within(place), OpenSystem(self._built.assembled) as opened:
            self._system: System = opened.system
            check_values(opened.system, self._built.assembled.system.values())
            self._inputs = {name: Endpoint.parse(end, f"{place}.inputs.{name}") for name, end in plant.inputs.items()}
            for name, end in self._inputs.items():
                drivable(opened.system, end, "can be driven", f"{place}.inputs.{name}")
            self._outputs = {name: self._shown(name, output) for name, output in plant.outputs.items()}

    @property
    def units(self) -> dict[str, str]:
        """Of the plant's inputs and outputs that have one."""
        found = {name: self._system.port(end).unit for name, end in self._inputs.items()}
        for name, output in self._plant.outputs.items():
            own = self._system.port(self._outputs[name].end).unit if output.factor == 1.0 else None
            found[name] = output.unit or own
        return {name: unit for name, unit in found.items() if unit}

    def bounds(self, name: str) -> tuple[float, float]:
        """Between which a parameter can lie."""
        found = settable(self._system, name)
        return found.lowest, found.highest

    def real(self, name: str) -> bool:
        """Whether a parameter is a real number."""
        return self._system.port(Endpoint.parse(name)).real

    def value(self, name: str) -> float:
        """Of a parameter, as the plant has it."""
        given = self._built.assembled.system.values().get(name)
        port = self._system.port(Endpoint.parse(name))
        return float(port.start or 0.0) if given is None else float(port.typed(name, given))

    def models(self, step: float, drawn: Mapping[str, FloatArray], count: int) -> list[LinearModel]:
        """The linear models with these values (N,) over its own."""
        components = self._plant.system.components
        parts = {name: self._slopes(name, component, drawn, count) for name, component in components.items()}
        return joined(parts, self._system.connections, self._inputs, self._outputs, step, self._place)

    def _slopes(self, name: str, component: ComponentSpec, drawn: Mapping[str, FloatArray], count: int) -> Slopes:
        place = f"{self._place}.components.{name}"
        values: dict[str, Value | FloatArray] = dict(self._built.assembled.system.components[name].parameters)
        for key, value in drawn.items():
            end = Endpoint.parse(key)
            if end.component == name:
                values[end.variable] = value
        if component.fmu is not None:
            found = fmu_slopes(place, component.fmu, values, count)
            self.remarks[name] = f"{place} ({component.fmu.name}) is linearised by {found.by}"
            return found
        return slopes(place, model_of(component), values, count)

    def _shown(self, name: str, output: PlantOutput) -> ShownOutput:
        place = f"{self._place}.outputs.{name}"
        end = Endpoint.parse(output.of, place)
        require(self._system, end, "output", "can be seen", place)
        return ShownOutput(end, output.factor)


def set_over(system: SystemSpec, values: Mapping[str, Value]) -> SystemSpec:
    """The system with values over those of its components.

    Raises:
        WiringError: there is no such component.
    """
    for name in values:
        if name.partition(".")[0] not in system.components:
            there = ", ".join(system.components)
            raise WiringError(f"set.{name}", "names no component of the plant", f"there are {there}")
    return system.given(values)


def beside(one: ParameterSpread, other: ParameterSpread) -> ParameterSpread:
    """Both spreads, which have nothing to do with each other.

    Raises:
        IdentificationError: both are of one parameter.
    """
    if twice := sorted({*one.names} & {*other.names}):
        raise IdentificationError(f"spread.{twice[0]}", "varies by itself and with the calibration", "leave one out")
    return ParameterSpread((*one.names, *other.names), block_diag(one.covariance, other.covariance))


def independent(deviations: Mapping[str, float]) -> ParameterSpread:
    """The spread of parameters with these standard deviations, each by itself."""
    return ParameterSpread(tuple(deviations), np.diag(np.square(list(deviations.values()))))
