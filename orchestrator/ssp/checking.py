"""Whether an SSP is as the standard has it: each document against its schema, and the system as a whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from fmus.errors import InputError
from fmus.files import package_folder
from orchestrator.ssp.document import imported
from orchestrator.ssp.names import SSB, SSD, SSM, SSV, Version
from orchestrator.ssp.package import SYSTEM, SspPackage

if TYPE_CHECKING:
    from lxml import etree

_SCHEMAS = {
    f"{SSD}SystemStructureDescription": "SystemStructureDescription",
    f"{SSV}ParameterSet": "SystemStructureParameterValues",
    f"{SSM}ParameterMapping": "SystemStructureParameterMapping",
    f"{SSB}SignalDictionary": "SystemStructureSignalDictionary",
}
_SUFFIXES = (".ssd", ".ssv", ".ssm", ".ssb")


@dataclass(frozen=True)
class Flaw:
    """Something that is wrong in a file of an SSP."""

    file: str
    problem: str


@dataclass(frozen=True)
class CheckedSsp:
    """What came out.

    Attributes:
        notes: what is to be known though it is not wrong, a line each.
    """

    version: str
    problems: tuple[Flaw, ...]
    notes: tuple[str, ...]


def check(path: Path) -> CheckedSsp:
    """Look at all documents of an SSP, and at what they make together.

    Raises:
        FmuFileError: it is no SSP at all.
    """
    problems: list[Flaw] = []
    with SspPackage(path) as package:
        roots = {name: package.xml(name) for name in package.names if name.lower().endswith(_SUFFIXES)}
    for name, root in roots.items():
        problems += [Flaw(name, line) for line in _complaints(root)]
    notes: tuple[str, ...] = ()
    try:
        notes = tuple(imported(path).notes)
    except InputError as error:
        problems.append(Flaw(path.name, str(error)))
    return CheckedSsp(roots[SYSTEM].get("version", ""), tuple(problems), notes)


def _complaints(root: etree._Element) -> Iterator[str]:
    """What the schema of a document has to say of it, and of those that stand inside it, each by its version."""
    for element in root.iter(*_SCHEMAS):
        version = element.get("version", "")
        if version not in list(Version):
            yield f"line {element.sourceline}: is of SSP version '{version}'; {' and '.join(Version)} are known"
            continue
        schema = _schema(_SCHEMAS[str(element.tag)], Version(version))
        if not schema.validate(element):
            for error in schema.error_log:
                yield f"line {error.line}: {error.message}"


@cache
def _schema(name: str, version: Version) -> etree.XMLSchema:
    """A schema: of SSP 1.0 as FMPy brings it along, of 2.0 as it lies beside this file."""
    from lxml import etree  # noqa: PLC0415 (slow to load)

    folder = package_folder("fmpy") / "ssp" if version is Version.ONE else Path(__file__).parent
    return etree.XMLSchema(etree.parse(folder / "schema" / f"{name}.xsd"))
