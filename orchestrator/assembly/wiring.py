"""Connections written in words, turned into links of a system and checked before anything runs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from fmus.errors import WiringError
from fmus.modelling.model import element_names
from fmus.words import with_article
from orchestrator.crossing import NOTHING_GIVEN, GivenConversion, crossing
from orchestrator.fmi.interface import Port
from orchestrator.system import REAL, ClockLink, Connection, Endpoint, Part, System, TextLink, drivable, giving, require

_TEXTS = ("String", "Binary")
_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_SCALED = re.compile(rf"(?:({_NUMBER})\s*\*\s*)?(.+?)(?:\s+([-+])\s+({_NUMBER}))?")


def wire(parts: Mapping[str, Part], connections: Iterable[tuple[str, str]], stimulated: Iterable[str] = ()) -> System:
    """The system with these connections (source, target), of variables or of whole arrays; units are converted where
    they differ. A source may have a factor and an offset, which then stand over the units: `2.5 * a.y + 1`.

    Raises:
        WiringError: an unknown name, a source that is not computed, a target that is no input (or parameter, where the
            source is a calculated one), a target with two sources, units of different quantities, types that do not
            fit, or an input that nothing sets.
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
    _one_source_each([*links, *clocks, *texts], driven, bare.carried)
    settled = tuple(link for link in links if bare.port(link.target).causality == "parameter")
    moving = tuple(link for link in links if link not in settled)
    system = System(dict(parts), moving, frozenset(driven), tuple(clocks), tuple(texts), settled)
    _every_input_set(system)
    return system


def scaled(text: str) -> tuple[Endpoint, GivenConversion]:
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
    return Endpoint.parse(name), GivenConversion(1.0 if factor is None else float(factor), signed)


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


def _kind(system: System, pair: tuple[Endpoint, Endpoint, GivenConversion]) -> str:
    """The type of both ends where it is one whose values are no numbers, else nothing; what is wrong is told later."""
    parts = [system.parts.get(end.component) for end in pair[:2]]
    ports = [part and part.interface.ports.get(end.variable) for part, end in zip(parts, pair[:2], strict=True)]
    kinds = {port.type if port else "" for port in ports}
    return kinds.pop() if kinds in ({"Clock"}, *({kind} for kind in _TEXTS)) else ""


def _text_link(system: System, source: Endpoint, target: Endpoint, given: GivenConversion) -> TextLink:
    place = f"{source} -> {target}"
    kind = require(system, source, "output", "can be a source", place).type
    require(system, target, "input", "can be a target", place)
    if given:
        raise WiringError(place, f"gives {with_article(kind)} a factor or an offset", "remove it")
    if system.port(source).array or system.port(target).array:
        raise WiringError(place, f"joins an element of an array of type {kind}", "connect scalars")
    return TextLink(source, target)


def _clock_link(system: System, source: Endpoint, target: Endpoint, given: GivenConversion) -> ClockLink:
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


def _link(system: System, source: Endpoint, target: Endpoint, given: GivenConversion) -> Connection:
    place = f"{source} -> {target}"
    output, input_ = giving(system, source, place), _taking(system, source, target, place)
    for port in (output, input_):
        if not port.numeric:
            like = {"Clock": "a clock to a clock", "Binary": "what is binary to its like"}
            fix = f"connect {like.get(port.type, 'a text to a text')}"
            raise WiringError(place, f"{with_article(port.type)} cannot be connected", fix)
    if output.type in REAL and input_.type not in REAL:
        raise WiringError(
            place,
            f"{with_article(output.type)} cannot drive {with_article(input_.type)}",
            "round it in a component between",
        )
    if (
        given
        and input_.type not in REAL
        and not all(float(x or 0.0).is_integer() for x in (given.factor, given.offset))
    ):
        problem = f"factor and offset give {with_article(input_.type)} no whole numbers"
        raise WiringError(place, problem, "round it in a component between")
    passed = crossing(place, output.measure, input_.measure, given)
    return Connection(source, target, passed.conversion.factor, passed.conversion.offset, passed)


def _taking(system: System, source: Endpoint, target: Endpoint, place: str) -> Port:
    """The variable that a connection gives numbers to: an input, or a parameter where its value is one, too."""
    port, given = system.port(target, place), system.port(source, place)
    if port.causality != "parameter":
        return require(system, target, "input", "can be a target", place)
    if given.causality != "calculatedParameter" and given.variability != "constant":
        problem = f"'{target}' is a parameter, and '{source}' changes while it runs"
        raise WiringError(place, problem, "connect a calculated parameter or a constant to it")
    return port


def _one_source_each(
    links: Iterable[Connection | ClockLink | TextLink], driven: Iterable[Endpoint], carried: Iterable[Endpoint]
) -> None:
    source_of = dict.fromkeys(carried, "a bus")
    for target, source in [(link.target, str(link.source)) for link in links] + [(e, "a stimulus") for e in driven]:
        if target in source_of:
            raise WiringError(str(target), f"has two sources, {source_of[target]} and {source}", "remove one")
        source_of[target] = source


def _every_input_set(system: System) -> None:
    sources = {link.target for link in system.links} | system.stimulated | system.carried
    for name, part in system.parts.items():
        for port in part.interface.of("input"):
            given = port.start is not None or port.array is not None or port.alone
            if Endpoint(name, port.name) not in sources and not given:
                raise WiringError(f"{name}.{port.name}", "is not connected and has no start value", "connect it")
