"""Which components there are and how they are wired, checked before anything runs."""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

from fmus.errors import WiringError
from fmus.modelling.model import element_names
from fmus.parameters.bounds import span
from orchestrator.crossing import NOTHING_GIVEN, Crossing, Given, crossing
from orchestrator.fmi.interface import Interface, Port, Value

FeedThrough = Literal["declared", "none", "all"]
_REAL = ("Real", "Float64", "Float32")
_TEXTS = ("String", "Binary")
_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_SCALED = re.compile(rf"(?:({_NUMBER})\s*\*\s*)?(.+?)(?:\s+([-+])\s+({_NUMBER}))?")


@dataclass(frozen=True)
class Part:
    """A component as the system sees it.

    Attributes:
        step: its communication step [s]; None takes the run's.
        feed_through: whether its outputs react to inputs within a step: as the FMU declares, never, or all of them.
    """

    interface: Interface
    step: Fraction | None = None
    feed_through: FeedThrough = "declared"

    def instant_outputs(self) -> frozenset[str]:
        """Outputs that must be passed on within the step they are computed in: all of a component's, or none.

        A component that has a continuous output without feed-through has dynamics (or is a source in continuous time):
        its outputs hold from the end of the step. Any other, a sampled controller or a static gain, reacts at once.
        """
        outputs = frozenset(self.interface.feed_through)
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
    """

    parts: Mapping[str, Part]
    connections: tuple[Connection, ...] = ()
    stimulated: frozenset[Endpoint] = field(default_factory=frozenset)
    clocks: tuple[ClockLink, ...] = ()
    texts: tuple[TextLink, ...] = ()

    @property
    def links(self) -> tuple[Connection | ClockLink | TextLink, ...]:
        """All by which a component acts on another: with numbers, ticks or texts."""
        return (*self.connections, *self.clocks, *self.texts)

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


def wire(parts: Mapping[str, Part], connections: Iterable[tuple[str, str]], stimulated: Iterable[str] = ()) -> System:
    """The system with these connections (source, target), of variables or of whole arrays; units are converted where
    they differ. A source may have a factor and an offset, which then stand over the units: `2.5 * a.y + 1`.

    Raises:
        WiringError: an unknown name, a source that is no output, a target that is no input, an input with two sources,
            units of different quantities, types that do not fit, or an input that nothing sets.
    """
    bare = System(dict(parts))
    ends = [(*scaled(source), Endpoint.parse(target)) for source, target in connections]
    pairs = [(*pair, given) for source, given, target in ends for pair in _pairs(bare, source, target)]
    kinds = [_kind(bare, pair) for pair in pairs]
    clocks = [_clock_link(bare, *pair) for kind, pair in zip(kinds, pairs, strict=True) if kind == "Clock"]
    texts = [_text_link(bare, *pair) for kind, pair in zip(kinds, pairs, strict=True) if kind in _TEXTS]
    links = [_link(bare, *pair) for kind, pair in zip(kinds, pairs, strict=True) if not kind]
    driven = [Endpoint.parse(name) for name in stimulated]
    for endpoint in driven:
        drivable(bare, endpoint, "can be stimulated")
    _one_source_each([*links, *clocks, *texts], driven)
    system = System(dict(parts), tuple(links), frozenset(driven), tuple(clocks), tuple(texts))
    _every_input_set(system)
    return system


@dataclass(frozen=True)
class Settable:
    """A parameter or start value that can be set.

    Attributes:
        lowest, highest: a number between them needs no other check; of what is not real none does.
    """

    component: str
    variable: str
    port: Port
    lowest: float
    highest: float

    def check(self, value: Value) -> None:
        """See that a value is of the variable's type and lies within the bounds.

        Raises:
            FmuFileError: it is of another type, or no item of the enumeration.
            WiringError: it is out of bounds, or would change the shapes of arrays.
        """
        name = f"{self.component}.{self.variable}"
        if not isinstance(value, str) and not math.isfinite(value):
            check_bounds(name, self.port, value)
        typed = self.port.typed(name, value)
        if self.port.causality == "structuralParameter" and typed != self.port.parsed(self.port.start or "0"):
            problem = f"is {self.port.start} and cannot be {value} in one run only"
            raise WiringError(name, problem, "sizes hold for all runs: give it among the `parameters`, or with --set")
        if not isinstance(typed, str):
            check_bounds(name, self.port, typed)


def settable(system: System, name: str) -> Settable:
    """What is set by this name.

    Raises:
        WiringError: there is no such variable, it cannot be set, or something else drives it.
    """
    endpoint = Endpoint.parse(name)
    port = system.port(endpoint)
    if not port.settable:
        kind = "constant" if port.variability == "constant" else port.causality
        raise WiringError(name, f"is {with_article(kind)} and cannot be set", "set a parameter or a start value")
    sources = {link.target: str(link.source) for link in system.links}
    sources |= dict.fromkeys(system.stimulated, "a stimulus")
    if endpoint in sources:
        raise WiringError(name, f"takes its value from {sources[endpoint]}", "do not set it")
    plain = port.type in _REAL
    lowest = (-sys.float_info.max if port.minimum is None else port.minimum) if plain else math.inf
    highest = (sys.float_info.max if port.maximum is None else port.maximum) if plain else -math.inf
    return Settable(endpoint.component, endpoint.variable, port, lowest, highest)


def typed(system: System, values: Mapping[str, Value]) -> dict[str, Value]:
    """component.variable -> value in the type and unit of its variable.

    Raises:
        FmuFileError: one is of another type.
        WiringError: there is no such variable, or a unit is of another quantity.
    """
    return {name: settable(system, name).port.typed(name, value) for name, value in values.items()}


def check_values(system: System, values: Mapping[str, Value]) -> None:
    """See that parameters and start values exist, can be set, are not overruled, and lie within their bounds.

    Raises:
        WiringError: one does not; the message names it.
    """
    for name, value in values.items():
        settable(system, name).check(value)


def check_bounds(name: str, port: Port, value: float) -> None:
    """See that a value is finite and lies within the variable's bounds.

    Raises:
        WiringError: it does not; the message names `name`.
    """
    if not math.isfinite(value):
        raise WiringError(name, f"is {value}", "give a finite number")
    low, high = port.minimum, port.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        raise WiringError(name, f"is {value:g}, outside its bounds {span(low, high)}", "choose a value inside")


def scaled(text: str) -> tuple[Endpoint, Given]:
    """The source of a connection, written `component.variable` or `2.5 * component.variable + 1`, and what it is
    converted by over its unit.

    Raises:
        WiringError: it names no variable.
    """
    match = _SCALED.fullmatch(text.strip())
    if match is None:
        return Endpoint.parse(text), NOTHING_GIVEN
    factor, name, sign, offset = match.groups()
    if factor is None and offset is None:
        return Endpoint.parse(name), NOTHING_GIVEN
    signed = 0.0 if offset is None else float(offset) * (-1 if sign == "-" else 1)
    return Endpoint.parse(name), Given(1.0 if factor is None else float(factor), signed)


def _pairs(system: System, source: Endpoint, target: Endpoint) -> Iterable[tuple[Endpoint, Endpoint]]:
    """The ends of a connection; where it joins whole arrays, those of each pair of elements."""
    shapes = [system.shape(end) for end in (source, target)]
    if None in shapes:
        return [(source, target)]
    if shapes[0] != shapes[1]:
        one, other = (" x ".join(map(str, shape or ())) for shape in shapes)
        problem = f"joins an array of {one} elements to one of {other}"
        raise WiringError(f"{source} -> {target}", problem, "connect elements, as y[1] -> u[2]")
    names = (element_names(end.variable, shapes[0] or ()) for end in (source, target))
    return [(replace(source, variable=y), replace(target, variable=u)) for y, u in zip(*names, strict=True)]


def _kind(system: System, pair: tuple[Endpoint, Endpoint, Given]) -> str:
    """The type of both ends where it is one whose values are no numbers, else nothing; what is wrong is told later."""
    parts = [system.parts.get(end.component) for end in pair[:2]]
    ports = [part and part.interface.ports.get(end.variable) for part, end in zip(parts, pair[:2], strict=True)]
    kinds = {port.type if port else "" for port in ports}
    return kinds.pop() if kinds in ({"Clock"}, *({kind} for kind in _TEXTS)) else ""


def _text_link(system: System, source: Endpoint, target: Endpoint, given: Given) -> TextLink:
    place = f"{source} -> {target}"
    kind = require(system, source, "output", "can be a source", place).type
    require(system, target, "input", "can be a target", place)
    if given:
        raise WiringError(place, f"gives {with_article(kind)} a factor or an offset", "remove it")
    if system.port(source).array or system.port(target).array:
        raise WiringError(place, f"joins an element of an array of type {kind}", "connect scalars")
    return TextLink(source, target)


def _clock_link(system: System, source: Endpoint, target: Endpoint, given: Given) -> ClockLink:
    place = f"{source} -> {target}"
    require(system, source, "output", "can be a source", place)
    require(system, target, "input", "can be a target", place)
    if given:
        raise WiringError(place, "gives a clock a factor or an offset", "remove it: a tick has no value")
    for end in (source, target):
        if not system.parts[end.component].interface.event_mode:
            problem = f"'{end}' is a clock of an FMU without event mode, which nobody can tick or ask"
            raise WiringError(place, problem, "export it with hasEventMode, or for model exchange")
    clock = system.parts[target.component].interface.clocks[target.variable]
    if clock.timed:
        raise WiringError(place, f"the {clock} ticks by itself", "remove the connection, or make the clock triggered")
    if source.component == target.component:
        raise WiringError(place, "has a component tick itself", "let it do that inside")
    return ClockLink(source, target)


def _link(system: System, source: Endpoint, target: Endpoint, given: Given) -> Connection:
    place = f"{source} -> {target}"
    output = require(system, source, "output", "can be a source", place)
    input_ = require(system, target, "input", "can be a target", place)
    for port in (output, input_):
        if not port.numeric:
            like = {"Clock": "a clock to a clock", "Binary": "what is binary to its like"}
            fix = f"connect {like.get(port.type, 'a text to a text')}"
            raise WiringError(place, f"{with_article(port.type)} cannot be connected", fix)
    if output.type in _REAL and input_.type not in _REAL:
        raise WiringError(
            place,
            f"{with_article(output.type)} cannot drive {with_article(input_.type)}",
            "round it in a component between",
        )
    if (
        given
        and input_.type not in _REAL
        and not all(float(x or 0.0).is_integer() for x in (given.factor, given.offset))
    ):
        problem = f"factor and offset give {with_article(input_.type)} no whole numbers"
        raise WiringError(place, problem, "round it in a component between")
    passed = crossing(place, output.measure, input_.measure, given)
    return Connection(source, target, passed.conversion.factor, passed.conversion.offset, passed)


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


def _one_source_each(links: Iterable[Connection | ClockLink | TextLink], driven: Iterable[Endpoint]) -> None:
    source_of: dict[Endpoint, str] = {}
    for target, source in [(link.target, str(link.source)) for link in links] + [(e, "a stimulus") for e in driven]:
        if target in source_of:
            raise WiringError(str(target), f"has two sources, {source_of[target]} and {source}", "remove one")
        source_of[target] = source


def _every_input_set(system: System) -> None:
    sources = {link.target for link in system.links} | system.stimulated
    for name, part in system.parts.items():
        for port in part.interface.of("input"):
            given = port.start is not None or port.array is not None or port.alone
            if Endpoint(name, port.name) not in sources and not given:
                raise WiringError(f"{name}.{port.name}", "is not connected and has no start value", "connect it")


def remarks(system: System, component: str, given: Container[str]) -> list[str]:
    """What is left to itself in a component that has these values."""
    interface = system.parts[component].interface
    ticked = {link.target for link in system.clocks}
    clocks = [
        clock.name
        for clock in interface.clocks.values()
        if clock.causality == "input" and Endpoint(component, clock.name) not in ticked
        if not (clock.timed and interface.event_mode)
    ]
    told = {link.target for link in system.texts}
    binaries = [
        port.name
        for port in interface.of("input")
        if port.type == "Binary" and Endpoint(component, port.name) not in told
    ]
    driven = {link.target for link in system.connections} | system.stimulated
    free = [
        port.name
        for port in (*interface.of("parameter"), *interface.of("input"))
        if port.array is not None and port.array.starts is None and port.name not in given
        if Endpoint(component, port.name) not in driven
    ]
    said = [f"nothing ticks its clocks ({_some(clocks)})"] if clocks else []
    if binaries:
        said.append(f"its binary inputs ({_some(binaries)}) keep what the FMU gives them")
    if interface.left_out:
        said.append(f"leaves out {_some(list(interface.left_out))}: `servotwin info` says why")
    if free:
        said.append(f"{_some(free)} of arrays without start values of this size keep what the FMU gives them")
    return said


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def with_article(noun: str) -> str:
    """The noun with a or an before it."""
    return f"an {noun}" if noun[0] in "aeioAEIO" else f"a {noun}"


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint to the name that is nearly this one, or to those there are."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    return f"there are {', '.join(names[:12])}" + (", ..." if len(names) > 12 else "") if names else "there are none"
