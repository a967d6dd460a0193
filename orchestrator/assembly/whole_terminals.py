"""Connections that join two terminals as wholes: those of their variables, by FMI 3.0's rules for matching."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fmus.errors import WiringError
from orchestrator.assembly.wiring import scaled
from orchestrator.fmi.terminals import FmuTerminal, read
from orchestrator.system import Endpoint, Part

LOG = logging.getLogger("servotwin.wiring")
Pair = tuple[str, str]
_SIGNAL, _FLOWS = "signal", ("inflow", "outflow")
_BUS = "org.fmi-ls-bus.network-terminal"


@dataclass(frozen=True)
class _End:
    """A terminal of a component that a connection names."""

    place: Endpoint
    terminal: FmuTerminal
    part: Part

    def variable(self, member: str) -> str:
        return f"{self.place.component}.{self.terminal.members[member]}"

    def causality(self, member: str) -> str:
        """That of a variable, or of the elements of an array; empty where there is none of this name."""
        name, ports = self.terminal.members[member], self.part.interface.ports
        found = {ports[name].causality} if name in ports else _of_elements(self.part, name)
        return found.pop() if found else ""

    def inner(self, name: str) -> _End:
        place = Endpoint(self.place.component, f"{self.place.variable}.{name}")
        return _End(place, self.terminal.inner[name], self.part)


def by_variables(connections: Iterable[Pair], parts: Mapping[str, Part], files: Mapping[str, Path]) -> tuple[Pair, ...]:
    """The connections, in place of those between terminals the ones between their variables.

    Args:
        files: component -> FMU, whose terminals are read where a name is that of no variable.

    Raises:
        WiringError: an end is a terminal and the other is none, or they do not match.
        FmuFileError: the terminals of an FMU cannot be used.
    """

    @cache
    def terminals(component: str) -> Mapping[str, FmuTerminal]:
        return dict(_all(read(files[component]))) if component in files else {}

    found: list[Pair] = []
    for source, target in connections:
        ends = [_end(text, parts, terminals) for text in (source, target)]
        found += _joined(f"{source} -> {target}", *ends) if any(ends) else [(source, target)]
    return tuple(found)


def _end(text: str, parts: Mapping[str, Part], terminals: Callable[[str], Mapping[str, FmuTerminal]]) -> _End | None:
    """The terminal that an end of a connection names, None where it names a variable, or nothing."""
    place, given = scaled(text)
    part = parts.get(place.component)
    if part is None or place.variable in part.interface.ports or part.interface.shape(place.variable):
        return None
    terminal = terminals(place.component).get(place.variable)
    if terminal is not None and given:
        raise WiringError(text, "gives a terminal a factor or an offset", "connect its variables one by one")
    return None if terminal is None else _End(place, terminal, part)


def _all(terminals: Mapping[str, FmuTerminal], before: str = "") -> Iterator[tuple[str, FmuTerminal]]:
    """Terminals by their names, those within others as `outer.inner`."""
    for name, terminal in terminals.items():
        yield f"{before}{name}", terminal
        yield from _all(terminal.inner, f"{before}{name}.")


def _of_elements(part: Part, array: str) -> set[str]:
    return {port.causality for port in part.interface.ports.values() if port.array and port.array.name == array}


def _joined(place: str, one: _End | None, other: _End | None) -> Iterator[Pair]:
    """The connections between the variables of two terminals, and of those within them."""
    if one is None or other is None:
        end = one or other
        assert end is not None
        problem = (
            f"{end.place} is a terminal, of {', '.join(end.terminal.members) or 'terminals'}; the other end is none"
        )
        raise WiringError(place, problem, "connect it to a terminal, or its variables one by one")
    _check(place, one, other)
    for ours, theirs in _matched(place, one, other):
        yield _pair(place, one, ours, other, theirs)
    for name in one.terminal.inner:
        if name in other.terminal.inner:
            yield from _joined(place, one.inner(name), other.inner(name))
    alone = one.terminal.inner.keys() ^ other.terminal.inner.keys()
    if alone:
        LOG.warning(
            "%s: %s: only one of them has this within, which stays unconnected", place, ", ".join(sorted(alone))
        )


def _check(place: str, one: _End, other: _End) -> None:
    """See that the rules for both are one, and known."""
    rules = one.terminal.rule, other.terminal.rule
    if _BUS in (one.terminal.kind, other.terminal.kind):
        raise WiringError(place, "joins terminals of a bus", "join them by `buses`")
    if rules[0] != rules[1]:
        raise WiringError(place, f"joins a '{rules[0]}' to a '{rules[1]}'", "connect their variables one by one")
    if rules[0] not in ("plug", "bus", "sequence"):
        raise WiringError(place, f"is to be matched by '{rules[0]}', which is not known", "connect the variables")
    for end in (one, other):
        if end.terminal.streams:
            problem = f"{end.place} has {', '.join(end.terminal.streams)}, which a flow carries along"
            raise WiringError(place, problem, "connect the other variables one by one")
    kinds = one.terminal.kind, other.terminal.kind
    if kinds[0] != kinds[1] and all(kinds):
        LOG.warning("%s: joins a '%s' to a '%s': they match by their members", place, *kinds)


def _matched(place: str, one: _End, other: _End) -> list[Pair]:
    """Members that belong together."""
    ours, theirs = list(one.terminal.members), list(other.terminal.members)
    if one.terminal.rule == "sequence":
        if len(ours) != len(theirs):
            raise WiringError(place, f"joins {len(ours)} members to {len(theirs)}", "connect them one by one")
        return list(zip(ours, theirs, strict=True))
    alone = sorted({*ours} ^ {*theirs})
    both = [name for name in ours if name in theirs]
    if one.terminal.rule == "plug" and alone:
        problem = f"only one of the terminals has {', '.join(alone)}, and as plugs they fit whole"
        raise WiringError(place, problem, "connect their variables one by one")
    if not both and (ours or theirs):
        raise WiringError(place, "joins terminals without a member in common", "connect their variables one by one")
    if alone:
        LOG.warning("%s: only one of the terminals has %s, which stays unconnected", place, ", ".join(alone))
    return [(name, name) for name in both]


def _pair(place: str, one: _End, ours: str, other: _End, theirs: str) -> Pair:
    """The connection of two members: from the output to the input; a flow that both count alike is turned round."""
    ends = {one.causality(ours): one.variable(ours), other.causality(theirs): other.variable(theirs)}
    if ends.keys() != {"input", "output"}:
        causes = [cause or "no variable" for cause in (one.causality(ours), other.causality(theirs))]
        problem = f"{one.variable(ours)} is {causes[0]} and {other.variable(theirs)} is {causes[1]}"
        raise WiringError(place, problem, "one has to be an output and the other an input: connect the others by name")
    kinds = one.terminal.kinds[ours], other.terminal.kinds[theirs]
    if kinds == (_SIGNAL, _SIGNAL) or sorted(kinds) == list(_FLOWS):
        return ends["output"], ends["input"]
    if kinds[0] == kinds[1] and kinds[0] in _FLOWS:
        return f"-1 * {ends['output']}", ends["input"]
    problem = f"{one.variable(ours)} is a '{kinds[0]}' and {other.variable(theirs)} a '{kinds[1]}'"
    raise WiringError(place, problem, "connect their variables one by one")
