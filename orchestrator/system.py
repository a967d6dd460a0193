"""Which components there are and how they are wired, checked before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, TypeVar

from fmus.errors import WiringError
from fmus.modelling.model import element_names
from fmus.words import nearest, with_article
from orchestrator.crossing import Crossing
from orchestrator.fmi.interface import Interface, Port

FeedThrough = Literal["declared", "none", "all"]
T = TypeVar("T")
REAL = ("Real", "Float64", "Float32")
COMPUTED = ("local", "calculatedParameter")  # what an FMU computes beside its outputs


def component_values(component: str, values: Mapping[str, T]) -> dict[str, T]:
    """variable -> value, of those of one component out of component.variable -> value."""
    prefix = f"{component}."
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def dotted_values(component: str, values: Mapping[str, T]) -> dict[str, T]:
    """component.variable -> value, of a component's variable -> value."""
    return {f"{component}.{name}": value for name, value in values.items()}


@dataclass(frozen=True)
class Part:
    """A component as the system sees it.

    Attributes:
        step: its communication step [s]; None takes the run's.
        feed_through: whether its outputs react to inputs within a step: as the FMU declares, never, or all of them.
        carried: its variables that a bus sees to.
        carries: of a bus, the components on it: it steps after them, as often as any.
    """

    interface: Interface
    step: Fraction | None = None
    feed_through: FeedThrough = "declared"
    carried: frozenset[str] = frozenset()
    carries: tuple[str, ...] = ()

    def instant_outputs(self) -> frozenset[str]:
        """Outputs that must be passed on within the step they are computed in: all of a component's, or none.

        A component that has a continuous output without feed-through has dynamics (or is a source in continuous time):
        its outputs hold from the end of the step. Any other, a sampled controller or a static gain, reacts at once.
        """
        outputs = frozenset(self.interface.feed_through)
        outputs = outputs and outputs.union(port.name for port in self.interface.of("local"))
        if self.feed_through != "declared":
            return outputs if self.feed_through == "all" else frozenset()
        return frozenset() if self._dynamic() else outputs

    def _dynamic(self) -> bool:
        return any(
            inputs is not None and not inputs and self.interface.ports[name].variability != "discrete"
            for name, inputs in self.interface.feed_through.items()
        )


@dataclass(frozen=True)
class Endpoint:
    """A variable of a component, written `component.variable`."""

    component: str
    variable: str

    @classmethod
    def parse(cls, text: str, place: str = "name") -> Endpoint:
        component, dot, variable = text.strip().partition(".")
        if not (component and dot and variable):
            raise WiringError(place, f"'{text}' does not name a variable", "write component.variable")
        return cls(component, variable)

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}"


@dataclass(frozen=True)
class Connection:
    """target = factor * source + offset; factor and offset convert units, as `crossing` says."""

    source: Endpoint
    target: Endpoint
    factor: float = 1.0
    offset: float = 0.0
    crossing: Crossing | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class _Link:
    source: Endpoint
    target: Endpoint

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


class ClockLink(_Link):
    """That the clock at the target ticks when the one at the source does."""


class TextLink(_Link):
    """That a text, or what is binary, at the target is that at the source."""


@dataclass(frozen=True)
class System:
    """Parts and the connections between them; build it with `wire`, which checks it.

    Attributes:
        clocks: the connections between clocks, which carry no values.
        texts: those of texts and of what is binary.
        settled: those into parameters, along which values pass once, in the initialisation.
    """

    parts: Mapping[str, Part]
    connections: tuple[Connection, ...] = ()
    stimulated: frozenset[Endpoint] = field(default_factory=frozenset)
    clocks: tuple[ClockLink, ...] = ()
    texts: tuple[TextLink, ...] = ()
    settled: tuple[Connection, ...] = ()

    @property
    def links(self) -> tuple[Connection | ClockLink | TextLink, ...]:
        """All by which a component acts on another: with numbers, ticks or texts."""
        return (*self.connections, *self.clocks, *self.texts, *self.settled)

    @property
    def carried(self) -> frozenset[Endpoint]:
        """What buses see to."""
        return frozenset(Endpoint(name, variable) for name, part in self.parts.items() for variable in part.carried)

    @property
    def crossings(self) -> list[Crossing]:
        """How values pass through the connections."""
        return [link.crossing for link in self.connections if link.crossing is not None]

    def port(self, endpoint: Endpoint, place: str = "") -> Port:
        """The variable at an endpoint.

        Raises:
            WiringError: no such component or variable; the message names the nearest that there are.
        """
        place = place or str(endpoint)
        if endpoint.component not in self.parts:
            raise WiringError(place, f"no component '{endpoint.component}'", nearest(endpoint.component, self.parts))
        ports = self.parts[endpoint.component].interface.ports
        if endpoint.variable in ports:
            return ports[endpoint.variable]
        if shape := self.shape(endpoint):
            size = " x ".join(map(str, shape))
            raise WiringError(
                place, f"is an array of {size} elements", f"name one, as {element_names(str(endpoint), shape)[0]}"
            )
        problem = f"no variable '{endpoint.variable}' in '{endpoint.component}'"
        raise WiringError(place, problem, nearest(endpoint.variable, ports))

    def shape(self, endpoint: Endpoint) -> tuple[int, ...] | None:
        """Shape of the array at an endpoint, None where there is none."""
        part = self.parts.get(endpoint.component)
        return (
            None
            if part is None or endpoint.variable in part.interface.ports
            else part.interface.shape(endpoint.variable)
        )


def require(system: System, endpoint: Endpoint, causality: str, role: str, place: str = "") -> Port:
    """The variable at an endpoint, which has that causality.

    Raises:
        WiringError: it has another, or there is no such variable; `place` is named, `role` says what it is for.
    """
    port = system.port(endpoint, place)
    if port.causality != causality:
        there = ", ".join(p.name for p in system.parts[endpoint.component].interface.of(causality)) or "none"
        kind = with_article(port.causality)
        raise WiringError(
            place or str(endpoint),
            f"'{endpoint}' is {kind}; only an {causality} {role}",
            f"{causality}s there: {there}",
        )
    return port


def giving(system: System, endpoint: Endpoint, place: str) -> Port:
    """The variable at an endpoint, from which a connection can take numbers: an output, a calculated parameter, or a
    local variable, which is taken as an output (SSP 2.0, Connectors).

    Raises:
        WiringError: it is another, or there is no such variable.
    """
    port = system.port(endpoint, place)
    return port if port.causality in COMPUTED else require(system, endpoint, "output", "can be a source", place)


def drivable(system: System, endpoint: Endpoint, role: str, place: str = "") -> Port:
    """The variable at an endpoint, which can be given values during a run: an input, or a tunable parameter.

    Raises:
        WiringError: it is neither, or there is no such variable; `place` is named, `role` says what it is for.
    """
    port = system.port(endpoint, place)
    if port.causality == "parameter" and port.numeric:
        if port.variability != "tunable":
            problem = f"'{endpoint}' is a {port.variability} parameter; only an input or a tunable one {role}"
            raise WiringError(place or str(endpoint), problem, "set it before the run")
        return port
    return require(system, endpoint, "input", role, place)


def recordable(system: System, name: str, place: str, texts: bool = False) -> Port:
    """The variable of this name, which is a number or, where `texts` will do, a text.

    Raises:
        WiringError: it is something else, or there is none; the message names `place`.
    """
    port = system.port(Endpoint.parse(name), place)
    if not (port.recordable if texts else port.numeric):
        wanted = "numbers and texts can be recorded" if texts else "a number is wanted"
        raise WiringError(place, f"is {with_article(port.type)}, and {wanted}", "choose another variable")
    return port


def must_be(system: System, name: str, causality: str, key: str) -> None:
    """See that a study names a variable of this causality; what has a start value passes for a parameter.

    Raises:
        WiringError: there is no such variable, or it is something else.
    """
    port = system.port(Endpoint.parse(name), f"{key}.{name}")
    if port.causality != causality and not (causality == "parameter" and port.start is not None):
        raise WiringError(f"{key}.{name}", f"is {with_article(port.causality)}", f"name {with_article(causality)}")
