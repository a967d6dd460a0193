"""What is inside of what, to any depth: the FMUs of an SSP, those in a container FMU, packed or unpacked, and the
models and FMUs of a system that was made one FMU."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.errors import FmuFileError
from fmus.packaging import archive
from fmus.packaging.system import manifest

DEEPEST = 10
_DESCRIPTION = "modelDescription.xml"
_PACKED = (".fmu", ".ssp")


@dataclass(frozen=True)
class Inside:
    """An archive, an unpacked FMU, or a model or a wire in the FMU of a system.

    Attributes:
        place: where it is in what it is inside of, or its name there; its path for the outermost one.
        model: name of the model; "" of an SSP or a wire.
        fmi: its version; "" of what is no FMU.
        note: what else is to be known of it.
    """

    KEYS = ("place", "model", "fmi", "holds", "note?")

    place: str
    model: str
    fmi: str
    holds: tuple[Inside, ...] = ()
    note: str = ""

    def lines(self, level: int = 0) -> Iterator[str]:
        """A line each, what is inside further in."""
        said = ", ".join(filter(None, [self.model, self.fmi and f"FMI {self.fmi}", self.note]))
        yield f"{'  ' * level}{self.place}{said and f': {said}'}"
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
    return _contents(files, place, called, level)


def _contents(files: Mapping[str, bytes], place: str, called: str, level: int) -> Inside:
    """What these files of an archive are; see `_archive`."""
    if level > DEEPEST:
        raise FmuFileError(called, f"is nested more than {DEEPEST} archives deep", "do not trust it")
    model, version = _described(files[_DESCRIPTION], called) if _DESCRIPTION in files else ("", "")
    if manifest.NAME not in files:
        return Inside(place, model, version, tuple(_within(files, called, level)))
    system = manifest.read(f"{called}: {manifest.NAME}", files[manifest.NAME])
    folders = tuple({part.folder for part in system.parts if part.folder})
    beside = {name: content for name, content in files.items() if not name.startswith(folders)}
    within = (*_within(beside, called, level), *_parts(system, files, called, level))
    return Inside(place, model, version, within, f"base step {system.base_step:.9g} s")


def _parts(system: manifest.SystemManifest, files: Mapping[str, bytes], called: str, level: int) -> Iterator[Inside]:
    """The parts of a system in one FMU, in the order in which they are stepped, and its wires."""
    for part in system.parts:
        note = f"every {part.step:.9g} s, outputs hold {part.outputs_hold}"
        if part.folder:
            own = {name.removeprefix(part.folder): text for name, text in files.items() if name.startswith(part.folder)}
            fmu = _contents(own, part.name, f"{called}: {part.folder}", level + 1)
            yield replace(fmu, note=f"{note}{fmu.note and f', {fmu.note}'}")
        else:
            yield Inside(part.name, part.model, "", (), note)
    for wire in system.wires:
        scaled = (wire.factor, wire.offset) != (1.0, 0.0)
        note = f"{wire.factor:.9g} * value + {wire.offset:.9g}" if scaled else ""
        yield Inside(f"{wire.source} -> {wire.target}", "", "", (), note)


def _within(files: Mapping[str, bytes], called: str, level: int) -> Iterator[Inside]:
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
