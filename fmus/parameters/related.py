"""Related files inside an FMU and what they are for, after FMI-LS-REF 1.0.0-alpha.1: its manifest, written and read."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree as ET

from fmus.packaging import archive
from fmus.packaging.description.xml import document

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
_HEAD = {
    f"{{{_LS}}}fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    f"{{{_LS}}}fmi-ls-version": "1.0.0-alpha.1",
    f"{{{_LS}}}fmi-ls-description": "Layered Standard providing information on related files included in an FMU.",
}
ET.register_namespace("fmi-ls", _LS)


@dataclass(frozen=True)
class Related:
    """A file that goes along with an FMU.

    Attributes:
        source: where it is, from the folder of the manifest.
        type: MIME type.
        role: parameter, result, experiment/smoke-test, ...
        checksum: its digest in hexadecimal, by `algorithm`; "" without one.
    """

    source: str
    type: str
    role: str
    description: str = ""
    checksum: str = ""
    algorithm: str = "SHA3-256"


def manifest(files: Sequence[Related], contents: Mapping[str, bytes], before: bytes | None = None) -> bytes:
    """The manifest of these files, each with the digest of its contents, which go by their sources; what it named
    `before` of others it still names."""
    root = ET.Element("fmiReferences", _HEAD) if before is None else ET.fromstring(before)
    for place, one in enumerate(files):
        for replaced in root.findall(f"Related[@source='{one.source}']"):
            root.remove(replaced)
        entry = {"type": one.type, "source": one.source, "role": one.role, "description": one.description}
        entry["checksum"] = hashlib.sha3_256(contents[one.source]).hexdigest()
        root.insert(place, ET.Element("Related", entry))
    return document(root)


def related(place: str, files: Mapping[str, bytes]) -> list[Related]:
    """What the manifest among an FMU's files names; nothing where there is none.

    Raises:
        FmuFileError: the manifest is no XML; the message names `place`.
    """
    if MANIFEST not in files:
        return []
    root = archive.parse_xml(f"{place}: {MANIFEST}", files[MANIFEST])
    return [
        Related(
            one.get("source", ""),
            one.get("type", "application/octet-stream"),
            one.get("role", ""),
            one.get("description", ""),
            one.get("checksum", ""),
            one.get("checksumType", "SHA3-256"),
        )
        for one in root.iterfind("Related")
    ]


def state(one: Related, files: Mapping[str, bytes]) -> str:
    """Whether a file that a manifest names is there as it was when the manifest was written, in a word or two."""
    parts = urlsplit(one.source)
    if parts.scheme or parts.netloc:
        return "elsewhere"
    content = files.get(_inside(unquote(parts.path)))
    if content is None:
        return "missing"
    name = one.algorithm.lower().replace("sha3-", "sha3_").replace("sha-", "sha")
    if not one.checksum or name not in hashlib.algorithms_guaranteed:
        return "there"
    return "unchanged" if hashlib.new(name, content).hexdigest() == one.checksum.lower() else "changed"


def _inside(path: str) -> str:
    """Name in the archive of what lies there from the folder of the manifest."""
    steps: list[str] = []
    for step in PurePosixPath(FOLDER, path).parts:
        if step != "..":
            steps.append(step)
        elif steps:
            steps.pop()
    return "/".join(steps)
