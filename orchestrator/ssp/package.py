"""The files of an SSP: an archive from outside, whose paths, sizes and XML are checked before anything is used."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import threading
import zipfile
import zlib
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from fmus import owned
from fmus.errors import FmuFileError
from fmus.files import sha256
from fmus.packaging import archive

if TYPE_CHECKING:
    from lxml import etree

SYSTEM = "SystemStructure.ssd"
LARGEST_XML = 256 << 20  # bytes
_NAME = "servotwin-ssp"
_lock = threading.Lock()
_homes: dict[int, Path] = {}  # number of a process -> where it has the files of archives, until it ends


class SspPackage:
    """An SSP, open for reading; a context manager.

    Args:
        called: what it is called in messages, by default its path.

    Raises (on opening):
        FmuFileError: no file, no zip, a path that leaves it, too much inside, or no description of a system.
    """

    def __init__(self, path: Path, called: str | None = None) -> None:
        self.path, self.called = path, called or str(path)
        self._read = set[str]()
        try:
            self._archive = archive.opened(path)
        except FmuFileError as error:
            raise FmuFileError(self.called, error.problem, error.fix.replace("the FMU", "the SSP")) from error
        if SYSTEM not in self._archive.NameToInfo:
            self._archive.close()
            raise FmuFileError(self.called, f"holds no {SYSTEM}", "is it an SSP?")

    def place(self, name: str) -> str:
        """What a file of it is called in messages."""
        return f"{self.called}: {name}"

    @property
    def names(self) -> list[str]:
        """All its files."""
        return [info.filename for info in self._archive.infolist() if not info.is_dir()]

    @property
    def variants(self) -> list[str]:
        """Descriptions of other systems, which nothing has read."""
        return [name for name in self.names if name.endswith(".ssd") and name not in self._read]

    def read(self, name: str) -> bytes:
        """The contents of a file.

        Raises:
            FmuFileError: there is none, or it is damaged.
        """
        info = self._archive.NameToInfo.get(name)
        if info is None:
            raise FmuFileError(self.place(name), "is not in the archive", "export the SSP again")
        try:
            self._read.add(name)
            return self._archive.read(info)
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, UnicodeError) as error:
            raise FmuFileError(self.place(name), f"cannot be unpacked ({error})", "export the SSP again") from error

    def xml(self, name: str) -> etree._Element:
        """The root of a document.

        Raises:
            FmuFileError: see `read` and `archive.parse_xml`.
        """
        info = self._archive.NameToInfo.get(name)
        if info is not None and info.file_size > LARGEST_XML:
            raise FmuFileError(self.place(name), "is over 256 MiB", "do not trust it")
        return archive.parse_xml(self.place(name), self.read(name))

    def resolved(self, source: str, base: str, place: str) -> str:
        """The file that a URI means which stands in the file `base`; `place` names where.

        Raises:
            FmuFileError: it leaves the archive, or is not in it.
        """
        parts = urlsplit(source)
        if parts.scheme or parts.netloc or parts.query or parts.fragment or not parts.path:
            raise FmuFileError(place, f"names the source '{source}', no file of the archive", "pack the file into it")
        steps: list[str] = []
        for step in PurePosixPath(base).parent.joinpath(unquote(parts.path).replace("\\", "/")).parts:
            if step == "..":
                if not steps:
                    raise FmuFileError(place, f"names the source '{source}' that leaves the archive", "do not trust it")
                steps.pop()
            else:
                steps.append(step)
        name = "/".join(steps)
        if name.startswith("/"):
            raise FmuFileError(place, f"names the source '{source}' that leaves the archive", "do not trust it")
        if name not in self._archive.NameToInfo:
            raise FmuFileError(place, f"names the source '{source}', which is not in the archive", "pack it into it")
        return name

    def unpacked(self, name: str) -> Path:
        """A file of it on the disk, until this process ends.

        Raises:
            FmuFileError: see `read`; or there is no room for it.
        """
        file = self._folder / name
        with _lock:
            if not file.is_file():
                _place(file, self.read(name))
        return file

    def kept(self, name: str, document: etree._Element) -> Path:
        """A document that stands for a file of it, on the disk until this process ends."""
        from lxml import etree  # noqa: PLC0415 (slow to load)

        file = self._folder / "kept" / name
        with _lock:
            _place(file, etree.tostring(document))
        return file

    @cached_property
    def _folder(self) -> Path:
        digest = sha256(self.path)
        with _lock:
            return _home() / digest

    def close(self) -> None:
        """Let go of the archive."""
        self._archive.close()

    def __enter__(self) -> SspPackage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _place(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content)
    part.replace(file)


def _home() -> Path:
    """The folder of this process; one, however many archives it reads."""
    process = os.getpid()
    folder = _homes.get(process)
    if folder is None or not folder.is_dir():
        parent = Path(tempfile.gettempdir())
        owned.sweep(parent, _NAME)
        folder, descriptor = owned.create(parent, _NAME)
        _homes[process] = folder
        atexit.register(_remove, folder, descriptor, process)
    return folder


def _remove(folder: Path, descriptor: int, process: int) -> None:
    """Remove a folder at the end of the process that made it, not of those that were forked off."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
        if descriptor >= 0:
            os.close(descriptor)
