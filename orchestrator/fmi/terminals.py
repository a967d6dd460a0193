"""The terminals of an FMU: which of its variables belong together, and in which roles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fmus.errors import FmuFileError
from fmus.packaging import archive
from fmus.packaging.description import terminals

if TYPE_CHECKING:
    from lxml import etree

NAMES = (
    "terminalsAndIcons/terminalsAndIcons.xml",
    "icons/terminalsAndIcons.xml",  # some do it so
    terminals.FMI2,
)
LARGEST = 16 << 20
Binaries = Mapping[str, Mapping[str, str]]  # name -> attributes


@dataclass(frozen=True)
class FmuTerminal:
    """A terminal.

    Attributes:
        kind, rule: what it is, and how it is to be connected, by their names.
        members: name of the member -> variable; what has no name is called as its variable.
        kinds: name of the member -> how it is to be connected: "signal", "inflow", "outflow", or a word of others.
        streams: names of the members that are carried along by a flow.
        inner: terminals in it, by their names.
    """

    name: str
    kind: str
    rule: str
    members: Mapping[str, str]
    kinds: Mapping[str, str]
    streams: tuple[str, ...]
    inner: Mapping[str, FmuTerminal]


def read(path: Path) -> dict[str, FmuTerminal]:
    """The terminals of an FMU file by their names; none where it has no file of them.

    Raises:
        FmuFileError: that file cannot be used.
    """
    with archive.opened(path) as zipped:
        there = next((name for name in NAMES if name in zipped.NameToInfo), None)
        if there is None:
            return {}
        if zipped.getinfo(there).file_size > LARGEST:
            raise FmuFileError(path, f"has a {there} over 16 MiB", "do not trust it")
        root = archive.parse_xml(f"{path}: {there}", zipped.read(there))
    return _terminals(f"{path}: {there}", root.find("Terminals"))


def binaries(path: Path) -> Binaries:
    """Variables of type Binary of an FMU of version 3, seen to be sound, with what their description says."""
    with archive.opened(path) as zipped:
        root = archive.parse_xml(f"{path}: modelDescription.xml", zipped.read("modelDescription.xml"))
    return {str(entry.get("name")): dict(entry.attrib) for entry in root.iterfind("ModelVariables/Binary")}


def _terminals(place: str, parent: etree._Element | None) -> dict[str, FmuTerminal]:
    found: dict[str, FmuTerminal] = {}
    for element in [] if parent is None else parent.findall("Terminal"):
        terminal = _terminal(place, element)
        if terminal.name in found:
            raise FmuFileError(place, f"two terminals are called '{terminal.name}'", "ask its supplier for a valid FMU")
        found[terminal.name] = terminal
    return found


def _terminal(place: str, element: etree._Element) -> FmuTerminal:
    members: dict[str, str] = {}
    kinds: dict[str, str] = {}
    for member in element.findall("TerminalMemberVariable"):
        variable = member.get("variableName")
        if not variable:
            raise FmuFileError(f"{place}: {element.get('name')}", "has a member without a variable", "correct it")
        name = member.get("memberName") or variable
        if name in members:
            raise FmuFileError(f"{place}: {element.get('name')}", f"has two members '{name}'", "correct it")
        members[name], kinds[name] = variable, member.get("variableKind") or ""
    streams = tuple(one.get("outStreamMemberName") or "" for one in element.findall("TerminalStreamMemberVariable"))
    name, kind, rule = (element.get(key) or "" for key in ("name", "terminalKind", "matchingRule"))
    return FmuTerminal(name, kind, rule, members, kinds, streams, _terminals(place, element))
