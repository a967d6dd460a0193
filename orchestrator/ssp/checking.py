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
from orchestrator.ssp.names import SSB, SSD, SSM, SSV
from orchestrator.ssp.package import SYSTEM, Package

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
class Problem:
    """Something that is wrong in a file of an SSP."""

    file: str
    problem: str


@dataclass(frozen=True)
class Checked:
    """What came out.

    Attributes:
        notes: what is to be known though it is not wrong, a line each.
    """

    version: str
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]


def check(path: Path) -> Checked:
    """Look at all documents of an SSP, and at what they make together.

    Raises:
        FmuFileError: it is no SSP at all.
    """
    problems: list[Problem] = []
    with Package(path) as package:
        roots = {name: package.xml(name) for name in package.names if name.lower().endswith(_SUFFIXES)}
    for name, root in roots.items():
        problems += [Problem(name, line) for line in _complaints(root)]
    notes: tuple[str, ...] = ()
    try:
        notes = tuple(imported(path).notes)
    except InputError as error:
        problems.append(Problem(path.name, str(error)))
    version = roots[SYSTEM].get("version", "")
    if version != "1.0":
        notes = (*notes, f"version {version} is read; only documents of 1.0 are validated, for lack of schemas")
    return Checked(version, tuple(problems), notes)


def _complaints(root: etree._Element) -> Iterator[str]:
    """What the schema of a document has to say of it, and of the documents that stand inside it."""
    if root.get("version") != "1.0":
        return
    for element in root.iter(*_SCHEMAS):
        schema = _schema(_SCHEMAS[str(element.tag)])
        if not schema.validate(element):
            for error in schema.error_log:
                yield f"line {error.line}: {error.message}"


@cache
def _schema(name: str) -> etree.XMLSchema:
    """A schema of SSP 1.0, as FMPy brings it along."""
    from lxml import etree  # noqa: PLC0415 (slow to load)

    return etree.XMLSchema(etree.parse(package_folder("fmpy") / "ssp" / "schema" / f"{name}.xsd"))
