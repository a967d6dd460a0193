"""Annotations of other tools in a description, kept as they are for when the system is written again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fmus.packaging import archive
from orchestrator.ssp.flattening import Path as Where
from orchestrator.ssp.flattening import component_names
from orchestrator.ssp.names import SSC, SSD

if TYPE_CHECKING:
    from lxml import etree

OURS = ("org.openmodelica", "com.opensimulationplatform")  # whose annotations are written anew
ROOT, SYSTEM = "/", "/system"  # beside names of components, which have no slash


def kept(file: Path) -> dict[str, list[bytes]]:
    """Name of a component -> its annotations as XML; those of the whole description and of its system, too.

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
    owners = {ROOT: root, SYSTEM: system, **{names[where]: element for where, element in components.items()}}
    found = {
        name: [
            etree.tostring(one, with_tail=False)
            for one in owner.iterfind(f"{SSD}Annotations/{SSC}Annotation")
            if one.get("type") not in OURS
        ]
        for name, owner in owners.items()
    }
    return {name: entries for name, entries in found.items() if entries}


def _components(system: etree._Element, path: Where) -> Iterator[tuple[Where, etree._Element]]:
    """All components below, in the order in which they are taken up."""
    for child in system.iterfind(f"{SSD}Elements/*"):
        where = (*path, child.get("name", ""))
        if child.tag == f"{SSD}System":
            yield from _components(child, where)
        elif child.tag == f"{SSD}Component":
            yield where, child
