"""Annotations of other tools in a description, kept as they are for when the system is written again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fmus.packaging import archive
from orchestrator.ssp.flattening import Path as Where
from orchestrator.ssp.flattening import component_names
from orchestrator.ssp.names import DEFINITION, PACKAGE, SSC, SSD
from orchestrator.ssp.package import SYSTEM as FIRST
from orchestrator.ssp.package import SspPackage

if TYPE_CHECKING:
    from lxml import etree

OURS = ("org.openmodelica", "com.opensimulationplatform")  # whose annotations are written anew
ROOT, SYSTEM = "/", "/system"  # beside names of components, which have no slash
_BRING = tuple(f"{SSD}{name}" for name in ("Component", "ParameterBinding", "ParameterMapping", "SignalDictionary"))
_INCLUDED = f"{SSD}SystemStructureDescription"


def whole(package: SspPackage, name: str = FIRST) -> etree._Element:
    """The description of a system that can be read, each of the documents that it brings along inside of the element
    that names it."""
    root = package.xml(name)
    for entry in [*root.iter(*_BRING)]:
        source, kind = entry.get("source"), entry.get("type")
        if source is None or entry.get("sourceBase") == "component":
            continue
        file = package.resolved(source, name, package.place(name))
        if kind == PACKAGE:
            with SspPackage(package.unpacked(file), package.place(file)) as inner:
                entry.append(whole(inner))
        elif kind == DEFINITION:
            entry.append(whole(package, file))
        elif entry.tag != f"{SSD}Component":
            entry.append(package.xml(file))
    return root


def kept(file: Path) -> dict[str, list[bytes]]:
    """Name of a component -> annotations as XML, of all in it and of its parameter sets; those of the whole description
    and of its system, whose are what no component has, too.

    Args:
        file: the description, see `whole`.

    Raises:
        FmuFileError: the file is no XML.
    """
    from lxml import etree  # noqa: PLC0415 (slow to load)

    root = archive.parse_xml(file, file.read_bytes())
    system = root.find(f"{SSD}System")
    if system is None:
        return {}
    components = dict(_components(system, ()))
    names: Mapping[Where, str] = component_names(list(components))
    owners = {root: ROOT, system: SYSTEM, **{element: names[where] for where, element in components.items()}}
    found: dict[str, list[bytes]] = {}
    for one in root.iter(f"{SSC}Annotation"):
        inside = next(one.iterancestors(f"{SSC}Annotation"), None)
        if inside is None and one.get("type") not in OURS:
            owner = next(owners[outer] for outer in one.iterancestors() if outer in owners)
            found.setdefault(owner, []).append(etree.tostring(one, with_tail=False))
    return found


def _components(system: etree._Element, path: Where) -> Iterator[tuple[Where, etree._Element]]:
    """All components below, in the order in which they are taken up."""
    for child in system.iterfind(f"{SSD}Elements/*"):
        where = (*path, child.get("name", ""))
        inner = child if child.tag == f"{SSD}System" else child.find(f"{_INCLUDED}/{SSD}System")
        if inner is not None:
            yield from _components(inner, where)
        elif child.tag == f"{SSD}Component":
            yield where, child
