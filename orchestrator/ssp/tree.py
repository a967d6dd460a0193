"""What is inside of what: the FMUs of an SSP, and those in a container FMU, packed or unpacked, to any depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.errors import FmuFileError
from fmus.packaging import archive

DEEPEST = 10
_DESCRIPTION = "modelDescription.xml"
_PACKED = (".fmu", ".ssp")


@dataclass(frozen=True)
class Inside:
    """An archive or unpacked FMU.

    Attributes:
        place: where it is in what it is inside of; its path for the outermost one.
        model: name of the model; "" of an SSP.
        version: of FMI; "" of an SSP.
    """

    place: str
    model: str
    version: str
    holds: tuple[Inside, ...] = ()

    def document(self) -> dict[str, object]:
        """The same in plain values."""
        holds = [one.document() for one in self.holds]
        return {"place": self.place, "model": self.model, "fmi": self.version, "holds": holds}

    def lines(self, level: int = 0) -> Iterator[str]:
        """A line each, what is inside further in."""
        said = f": {self.model}, FMI {self.version}" if self.model else ""
        yield f"{'  ' * level}{self.place}{said}"
        for one in self.holds:
            yield from one.lines(level + 1)


def tree(path: Path) -> Inside:
    """What an FMU or an SSP holds.

    Raises:
        FmuFileError: it, or what is in it, cannot be read.
    """
    return _archive(path, str(path), str(path), 0)


def _archive(path: Path, place: str, called: str, level: int) -> Inside:
    """An archive at `path`, which is at `place` in what it is inside of, and `called` so in messages."""
    if level > DEEPEST:
        raise FmuFileError(called, f"is nested more than {DEEPEST} archives deep", "do not trust it")
    try:
        files = archive.read(path)
    except FmuFileError as error:
        raise FmuFileError(called, error.problem, error.fix) from error
    model, version = _described(files[_DESCRIPTION], called) if _DESCRIPTION in files else ("", "")
    return Inside(place, model, version, tuple(_within(files, called, level)))


def _within(files: dict[str, bytes], called: str, level: int) -> Iterator[Inside]:
    """What lies in an archive; of an unpacked FMU what lies in its folder belongs to it."""
    for name in sorted(files):
        here = f"{called}: {name}"
        if name.lower().endswith(_PACKED):
            with TemporaryDirectory(prefix="servotwin-") as folder:
                file = Path(folder) / "inner"
                file.write_bytes(files[name])
                yield _archive(file, name, here, level + 1)
        elif name.endswith(f"/{_DESCRIPTION}"):
            yield Inside(name.removesuffix(f"/{_DESCRIPTION}"), *_described(files[name], here))


def _described(text: bytes, called: str) -> tuple[str, str]:
    """Name of the model and version of FMI."""
    root = archive.parse_xml(called, text)
    return str(root.get("modelName", "?")), str(root.get("fmiVersion", "?"))
