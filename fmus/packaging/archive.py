"""FMU archives: written so that equal contents give equal bytes, read with path and size checks."""

from __future__ import annotations

import hashlib
import logging
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from fmus.errors import FmuFileError
from fmus.files import absence, atomic_write

if TYPE_CHECKING:
    from lxml import etree

LOG = logging.getLogger("servotwin.archive")
LARGEST_UNPACKED = 4 << 30
MOST_ENTRIES = 100_000
LARGEST_RATIO, SMALL = 200, 64 << 20  # of what is inside to the file, where that is more than a few [bytes]
_FOLDERS = ("binaries", "documentation", "resources", "sources")
_EPOCH = (1980, 1, 1, 0, 0, 0)


def write(path: Path, files: Mapping[str, bytes]) -> None:
    """A zip of `files` (archive name -> contents), sorted, without dates; written beside and renamed."""
    atomic_write(path, partial(_fill, files=files))


def _fill(file: BinaryIO, files: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry in sorted(files):
            info = zipfile.ZipInfo(entry, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, files[entry])


def digest(files: Mapping[str, bytes]) -> str:
    """Hexadecimal SHA-256 of names and contents."""
    hashing = hashlib.sha256()
    for name in sorted(files):
        hashing.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return hashing.hexdigest()


def read(path: Path) -> dict[str, bytes]:
    """Every file of an archive, by name.

    Raises:
        FmuFileError: no such file, no zip, damaged, a path that leaves the archive, or more than 4 GiB inside.
    """
    with opened(path) as archive:
        try:
            return {info.filename: archive.read(info) for info in archive.infolist() if not info.is_dir()}
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, UnicodeError) as error:
            raise FmuFileError(path, f"cannot be unpacked ({error})", "export the FMU again") from error


def opened(path: Path) -> zipfile.ZipFile:
    """The archive, open for reading and seen to be safe to unpack.

    Raises:
        FmuFileError: as for `read`.
    """
    if not path.is_file():
        raise FmuFileError(path, absence(path), "check the path")
    try:
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError, UnicodeError) as error:
        raise FmuFileError(path, f"is not a zip archive ({error})", "export the FMU again") from error
    for info in archive.infolist():
        parts = info.filename.replace("\\", "/").split("/")
        if ".." in parts or info.filename.startswith(("/", "\\")) or ":" in parts[0]:
            archive.close()
            raise FmuFileError(path, f"holds the path '{info.filename}' that leaves the archive", "do not trust it")
    if problem := _too_much(archive, path.stat().st_size):
        archive.close()
        raise FmuFileError(path, problem, "do not trust it")
    for info in archive.infolist():
        info.filename = _canonical(info.filename)
    archive.filelist[:] = [info for info in archive.infolist() if info.filename]
    if twice := _twice(archive, path):
        archive.close()
        raise FmuFileError(path, f"holds {twice}, with different contents", "zip it again with the one that is meant")
    archive.NameToInfo = {info.filename: info for info in archive.infolist()}
    archive.filelist[:] = archive.NameToInfo.values()
    return archive


def _twice(archive: zipfile.ZipFile, path: Path) -> str:
    """Two entries of which it is not sure which one counts; empty where there are none.

    Names that differ only in case are two files of resources here and one on other systems, which is told.
    """
    known: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        other = known.setdefault(info.filename.lower(), info)
        if info.is_dir() or (other.CRC, other.file_size) == (info.CRC, info.file_size):
            continue
        if other.filename == info.filename:
            return f"'{info.filename}' twice"
        both = f"'{other.filename}' and '{info.filename}'"
        if "/" not in info.filename or info.filename.startswith("binaries/"):
            return both
        _tell(path, both)
    return ""


@cache  # once for each archive, however often it is opened
def _tell(path: Path, both: str) -> None:
    LOG.warning("%s: holds %s, which are one file on Windows", path, both)


def _too_much(archive: zipfile.ZipFile, size: int) -> str:
    """Why an archive of this size [bytes] is not unpacked; empty where it may be."""
    entries = len(archive.infolist())
    unpacked = sum(info.file_size for info in archive.infolist())
    if entries > MOST_ENTRIES:
        return f"holds {entries:,} files, more than {MOST_ENTRIES:,}"
    if unpacked > LARGEST_UNPACKED:
        return f"unpacks to {unpacked:,} bytes, more than 4 GiB"
    if unpacked > SMALL and unpacked > LARGEST_RATIO * size:
        return f"unpacks to {unpacked / size:.0f} times its size"
    return ""


def _canonical(name: str) -> str:
    """An entry's name as FMI writes it, where the tool that zipped it took backslashes, `./` or other capitals."""
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    folder = name.endswith(("/", "\\"))
    if len(parts) > 1 or folder:
        parts[:1] = [part.lower() if part.lower() in _FOLDERS else part for part in parts[:1]]
        if parts[:1] == ["binaries"] and (len(parts) > 2 or folder):
            parts[1:2] = [part.lower() for part in parts[1:2]]
    return "/".join(parts) + ("/" if parts and folder else "")


def parse_xml(place: object, text: bytes) -> etree._Element:
    """The root of an XML document from outside: no document type, no entities, no network.

    Raises:
        FmuFileError: not XML, or it declares a document type.
    """
    from lxml import etree  # noqa: PLC0415 (most users of archives read no XML)

    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        raise FmuFileError(place, f"is not XML ({error})", "export it again") from error
    if root.getroottree().docinfo.doctype:
        raise FmuFileError(place, "declares a document type", "do not trust it")
    return root


def xml_text(root: etree._Element) -> bytes:
    """The document of a root."""
    from lxml import etree  # noqa: PLC0415 (see above)

    return bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True))
