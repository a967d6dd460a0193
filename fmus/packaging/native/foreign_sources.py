"""FMUs of others that bring C sources along, compiled for this and other platforms.

Nothing here is done unasked: what was compiled is somebody else's program, and it is run like any other FMU's. The
libraries made for this platform are kept in the cache under the hash of the FMU file.
"""

from __future__ import annotations

import re
import shlex
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from fmus.errors import FmuFileError, ModelError
from fmus.files import package_folder, sha256
from fmus.packaging import archive, cache
from fmus.packaging.fingerprint import fingerprint
from fmus.packaging.native import compiler
from fmus.packaging.native.compiler import Platform

if TYPE_CHECKING:
    from lxml import etree

_BUILD = "sources/buildDescription.xml"
_CPP = (".cpp", ".cc", ".cxx")
_LANGUAGE = re.compile(r"C(\+\+)?(\d\d)")
_MACRO = re.compile(r"[A-Za-z_]\w*(\([\w, ]*\))?")
_NAMES = "servotwin_names.h"


@dataclass(frozen=True)
class SourceFiles:
    """Files that are compiled alike; all paths lie below `sources/`.

    Attributes:
        flags: definitions, and the version of the language.
        folders: where headers are looked for.
    """

    files: tuple[str, ...]
    flags: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()


@dataclass(frozen=True)
class ForeignSources:
    """What an FMU's library is made of.

    Attributes:
        fmi: 2 or 3.
        libraries: model identifier -> the sets of files that become its library.
        notes: what was taken otherwise than the FMU says, or without its saying.
    """

    fmi: int
    libraries: Mapping[str, tuple[SourceFiles, ...]]
    notes: tuple[str, ...] = ()


def brings(names: Iterable[str]) -> bool:
    """Whether there are C sources among the files of an FMU."""
    return any(name.startswith("sources/") and name.endswith((".c", *_CPP)) for name in names)


def kept(path: Path, identifier: str) -> bytes | None:
    """The library for this platform that was compiled from this FMU's sources before."""
    try:
        found = cache.current()
        return None if found is None else found.get(_key(path, identifier))
    except ModelError:  # no platform that native FMUs are built for
        return None


def build(path: Path, out: Path, platforms: Sequence[str] = ("host",)) -> tuple[str, ...]:
    """Write the FMU with libraries compiled from its own sources; the original stays as it is. Notes come back.

    Args:
        platforms: names of `compiler.PLATFORMS`, "host" or "all".

    Raises:
        FmuFileError: no FMU, without sources, or its list of them is wrong.
        ModelError: no compiler, or it failed.
    """
    files = archive.read(path)
    if out.exists() and out.samefile(path):
        raise FmuFileError(path, "would be replaced", "give another folder with --out")
    sources = described(path, files)
    added: dict[str, bytes] = {}
    for target in compiler.find(platforms):
        for identifier, sets in sources.libraries.items():
            library = _compiled(path, files, sources.fmi, identifier, sets, target)
            folder = target.folder2 if sources.fmi == 2 else target.name
            added[f"binaries/{folder}/{identifier}{target.suffix}"] = library
            found = cache.current()
            if found is not None and target == compiler.host():
                found.put(_key(path, identifier), library)
    archive.write(out, files | added)
    return sources.notes


def described(path: Path, files: Mapping[str, bytes]) -> ForeignSources:
    """What there is to be compiled, as the FMU says it.

    Args:
        files: contents of the FMU by name.
    """
    description = "modelDescription.xml"
    if description not in files:
        raise FmuFileError(path, f"holds no {description}", "is it an FMU?")
    root = archive.parse_xml(f"{path}: {description}", files[description])
    offers = [entry for tag in ("CoSimulation", "ModelExchange") for entry in root.iterfind(tag)]
    identifiers = list(dict.fromkeys(str(entry.get("modelIdentifier")) for entry in offers))
    there = sorted(name.removeprefix("sources/") for name in files if name.startswith("sources/"))
    if not there:
        raise FmuFileError(path, "brings no sources along", "export it for this platform")
    for identifier in identifiers:
        if not re.fullmatch(r"[A-Za-z_]\w*", identifier):
            raise FmuFileError(path, f"has the model identifier '{identifier}'", "do not trust it")
    modern = str(root.get("fmiVersion")).startswith("3")
    if modern:
        found, notes = _listed_by_3(path, files, identifiers)
    else:
        found, notes = {str(entry.get("modelIdentifier")): _listed_by_2(entry) for entry in offers}, []
    for identifier in identifiers:
        if not any(part.files for part in found.get(identifier, ())):
            found[identifier], note = _unlisted(path, there)
            notes.append(note)
    for name in (name for sets in found.values() for part in sets for name in part.files):
        if name not in there:
            raise FmuFileError(path, f"lists the source '{name}', which it does not hold", "ask its supplier for all")
    return ForeignSources(3 if modern else 2, {name: found[name] for name in identifiers}, tuple(dict.fromkeys(notes)))


def _listed_by_2(offer: etree._Element) -> tuple[SourceFiles, ...]:
    return (SourceFiles(tuple(_inside(str(entry.get("name"))) for entry in offer.iterfind("SourceFiles/File"))),)


def _listed_by_3(
    path: Path, files: Mapping[str, bytes], identifiers: Sequence[str]
) -> tuple[dict[str, tuple[SourceFiles, ...]], list[str]]:
    """Sets of files by model identifier, and notes."""
    if _BUILD not in files:
        return {}, []
    root = archive.parse_xml(f"{path}: {_BUILD}", files[_BUILD])
    notes: list[str] = []
    found = {
        str(entry.get("modelIdentifier")): tuple(_set(path, part, notes) for part in entry.iterfind("SourceFileSet"))
        for entry in root.iterfind("BuildConfiguration")
    }
    missing = [identifier for identifier in identifiers if identifier not in found]
    if missing and len(found) == 1:
        (other,) = found
        notes.append(f"its build description is for '{other}'; taken for {', '.join(missing)}")
        found |= dict.fromkeys(missing, found[other])
    return found, notes


def _set(path: Path, part: etree._Element, notes: list[str]) -> SourceFiles:
    flags = []
    for entry in part.iterfind("PreprocessorDefinition"):
        name, value = str(entry.get("name")), entry.get("value")
        if not _MACRO.fullmatch(name):
            raise FmuFileError(path, f"defines '{name}', which is no name of a macro", "ask its supplier to mend it")
        if entry.get("optional") not in ("true", "1"):
            flags.append(f"-D{name}" if value is None else f"-D{name}={value}")
    language = str(part.get("language") or "")
    if match := _LANGUAGE.fullmatch(language):
        flags.append(f"-std=gnu{match[1] or ''}{match[2]}")
    elif language:
        notes.append(f"the language '{language}' is not known; the compiler's own is taken")
    if options := part.get("compilerOptions"):
        notes.append(f"the options '{options}' for {part.get('compiler') or 'a compiler'} are left out")
    return SourceFiles(
        tuple(_inside(str(entry.get("name"))) for entry in part.iterfind("SourceFile")),
        tuple(flags),
        tuple(_inside(str(entry.get("name"))) for entry in part.iterfind("IncludeDirectory")),
    )


def _unlisted(path: Path, there: Sequence[str]) -> tuple[tuple[SourceFiles, ...], str]:
    """What is compiled where the FMU does not say: `all.c`, which includes the others, or every file at the top."""
    top = tuple(name for name in there if "/" not in name and name.endswith((".c", *_CPP)))
    units = ("all.c",) if "all.c" in top else top
    if not units:
        raise FmuFileError(path, "brings no C sources along", "export it for this platform")
    return (SourceFiles(units),), f"it does not say what to compile; taken: {', '.join(units)}"


def _inside(name: str) -> str:
    """A path below the sources as archives write it; one that leads out of them is none that they hold."""
    return str(PurePosixPath(name.replace("\\", "/")))


def _compiled(
    path: Path, files: Mapping[str, bytes], fmi: int, identifier: str, sets: Sequence[SourceFiles], target: Platform
) -> bytes:
    headers = package_folder("fmpy") / "c-code"
    place = f"{path}, {target.name}"
    cc = (*compiler.command_for(target), *compiler.position(target), "-w", "-O2")
    with tempfile.TemporaryDirectory(prefix="servotwin-cc-") as folder:
        for name, content in files.items():
            if name.startswith("sources/"):
                there = Path(folder) / name
                there.parent.mkdir(parents=True, exist_ok=True)
                there.write_bytes(content)
        (Path(folder) / _NAMES).write_text("".join(_renamed(headers, fmi, identifier)))
        objects: list[str] = []
        for part in sets:
            include = [f"-I{Path('sources', below)}" for below in (".", *part.folders) if ".." not in below.split("/")]
            for unit in part.files:
                objects.append(f"{len(objects)}.o")
                flags = [*part.flags, "-include", _NAMES, *include, f"-I{headers}"]
                command = [*cc, *flags, "-c", f"sources/{unit}", "-o", objects[-1]]
                compiler.LOG.info("in %s: %s", folder, shlex.join(command))
                compiler.run(command, folder, place)
        plus = ["-lstdc++"] if any(unit.endswith(_CPP) for part in sets for unit in part.files) else []
        library = identifier + target.suffix
        link = [*cc, "-shared", "-s", "-o", library, *objects, *plus, *compiler.libraries(target)]
        compiler.run(link, folder, place)
        return (Path(folder) / library).read_bytes()


def _renamed(headers: Path, fmi: int, identifier: str) -> Iterator[str]:
    """Definitions that give functions their plain names: in sources they have the identifier in front of them."""
    for name in re.findall(rf"\bfmi{fmi}FullName\((\w+)\)", (headers / f"fmi{fmi}Functions.h").read_text()):
        yield f"#define {identifier}_{name} {name}\n"


def _key(path: Path, identifier: str) -> str:
    return fingerprint("from sources", sha256(path), identifier, compiler.host().name)
