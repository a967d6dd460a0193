"""Parts that several files share: what `include` names, joined into one document that knows where each key stands.

Maps are joined key by key, and what the including file says counts. Lists at the top (connections, expectations, cases)
are appended. A component that names another model, and a stimulus, are taken whole. Of an SSP that is included the
components and connections are taken.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap, CommentedSeq

from fmus.errors import ScenarioError
from orchestrator.documents import sources
from orchestrator.documents.parsing import one_line
from orchestrator.ssp import is_ssp

INCLUDE, PART = "include", "part"
MOST = 100  # files that make one document
_SYSTEM = ("components", "connections")
_PROJECT = (".git", ".hg", "pyproject.toml")  # what the folder of a project holds

PathsOf = Callable[[Any], Iterator[tuple[Any, Any]]]
"""Where a document names files: pairs of a map or list in it and a key of that."""


@dataclass(frozen=True)
class SourceLine:
    """Where something stands: the file and the line, from 1."""

    file: Path
    line: int


class JoinedMap(CommentedMap):
    """A map from several files; `places` has the place of each key."""

    places: dict[Any, SourceLine]


class JoinedList(CommentedSeq):
    """A list from several files; `places` has the place of each entry."""

    places: list[SourceLine]


@dataclass
class _Reading:
    """One document on its way: the files that it is from, and what names files in it."""

    paths_of: PathsOf
    files: list[Path] = field(default_factory=list)


def document_of(path: Path, paths_of: PathsOf) -> tuple[CommentedMap, tuple[Path, ...]]:
    """The document of a file joined with the parts that it includes, and these parts.

    Names of files in parts are rewritten to be relative to the folder of `path`.

    Raises:
        ScenarioError: a part is not there, is none, lies outside the project, or includes itself; or a file is no YAML.
    """
    reading = _Reading(paths_of)
    own, folder = sources.parse(path)
    _rebase(own, folder, path.parent, paths_of)
    document = _joined(path, own, (path.resolve(),), reading)
    return document, tuple(reading.files)


def place_of(document: Any, path: Path, keys: Sequence[Any]) -> SourceLine:
    """Where the deepest of these keys stands that the document has; `path` is its file."""
    node, place = document, SourceLine(path, 1)
    for key in keys:
        if isinstance(node, CommentedMap) and key in node:
            known = node.places[key] if isinstance(node, JoinedMap) else SourceLine(place.file, node.lc.key(key)[0] + 1)
        elif isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node):
            known = (
                node.places[key] if isinstance(node, JoinedList) else SourceLine(place.file, node.lc.item(key)[0] + 1)
            )
        else:
            break
        node, place = node[key], known
    return place


def _joined(path: Path, own: CommentedMap, chain: tuple[Path, ...], reading: _Reading) -> CommentedMap:
    """A file's document over those that it includes; `chain` leads from the first file to this one."""
    shared: CommentedMap | None = None
    shared_path = path
    for number, name in enumerate(_included(path, own)):
        part = _part(path, own, number, name)
        place = part.resolve()
        if place in chain:
            names = " -> ".join(on_the_way.name for on_the_way in (*chain[chain.index(place) :], place))
            raise _refused(path, own, number, f"includes itself: {names}", "leave one of these out")
        if place in reading.files:
            continue
        reading.files.append(place)
        if len(reading.files) > MOST:
            raise _refused(path, own, number, f"is made of more than {MOST} files", "join some")
        below = _joined(part, _parsed(part), (*chain, place), reading)
        _rebase(below, part.parent, path.parent, reading.paths_of)
        del below[PART]
        below.pop(INCLUDE, None)
        shared, shared_path = (below, part) if shared is None else (_over(below, part, shared, shared_path), path)
    return own if shared is None else _over(own, path, shared, shared_path)


def _included(path: Path, own: CommentedMap) -> list[str]:
    names = own.get(INCLUDE, [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        line = place_of(own, path, [INCLUDE]).line
        raise ScenarioError(f"{path}:{line}: {INCLUDE}", "is no list of files", "write `include: [sensors.yaml]`")
    return names


def _part(path: Path, own: CommentedMap, number: int, name: str) -> Path:
    """The file of a part that `path` includes: in its project, so that it is there wherever that is checked out."""
    root = _project(path)
    part = path.parent / name
    if Path(name).is_absolute() or not part.resolve().is_relative_to(root):
        raise _refused(path, own, number, f"{one_line(name)} lies outside of {root}", "copy it there")
    if not part.is_file():
        raise _refused(path, own, number, f"there is no file {one_line(name)}", "check the path")
    return part


def _project(path: Path) -> Path:
    """The folder of the project that a file is of; the one above the file's where none looks like it."""
    folders = path.resolve().parents
    return next((folder for folder in folders if any((folder / mark).exists() for mark in _PROJECT)), folders[1])


def _parsed(part: Path) -> CommentedMap:
    document, _ = sources.parse(part)
    if is_ssp(part):
        for key in [key for key in document if key not in _SYSTEM]:
            del document[key]
        document[PART] = part.name
    if PART not in document:
        raise ScenarioError(part, "is included, and is no part", f"begin it with `{PART}:` and what it is")
    return document


def _refused(path: Path, own: CommentedMap, number: int, problem: str, fix: str) -> ScenarioError:
    place = place_of(own, path, [INCLUDE, number])
    return ScenarioError(f"{path}:{place.line}: {INCLUDE}", problem, fix)


def _rebase(document: CommentedMap, former: Path, base: Path, paths_of: PathsOf) -> None:
    """Rewrite names of files that are relative to one folder so that they are to another."""
    if former == base:
        return
    for node, key in paths_of(document):
        if not Path(node[key]).is_absolute():
            node[key] = os.path.relpath(former / node[key], base)


def _over(own: CommentedMap, path: Path, shared: CommentedMap, below: Path, keys: tuple[Any, ...] = ()) -> JoinedMap:
    """The keys of both maps, joined where both have one; `path` and `below` are the files they are from."""
    made = JoinedMap()
    made.places = {}
    ours, theirs = _places(own, path), _places(shared, below)
    for key in dict.fromkeys([*shared, *own]):
        place = ours.get(key) or theirs[key]
        if key not in own or key not in shared:
            value = own[key] if key in own else shared[key]
        else:
            value = _value(own[key], place.file, shared[key], theirs[key].file, (*keys, key))
        made[key], made.places[key] = value, place
    return made


def _value(own: Any, path: Path, shared: Any, below: Path, keys: tuple[Any, ...]) -> Any:
    if isinstance(own, CommentedMap) and isinstance(shared, CommentedMap) and not _is_whole(own, keys):
        return _over(own, path, shared, below, keys)
    if isinstance(own, CommentedSeq) and isinstance(shared, CommentedSeq) and len(keys) == 1:
        joined = JoinedList([*shared, *own])
        joined.places = [*_entries(shared, below), *_entries(own, path)]
        return joined
    return own


def _is_whole(own: CommentedMap, keys: tuple[Any, ...]) -> bool:
    """Whether what a file says here stands for all that a part says."""
    return len(keys) == 2 and (keys[0] == "stimuli" or (keys[0] == "components" and ("model" in own or "fmu" in own)))


def _places(node: CommentedMap, file: Path) -> dict[Any, SourceLine]:
    return (
        node.places if isinstance(node, JoinedMap) else {key: SourceLine(file, node.lc.key(key)[0] + 1) for key in node}
    )


def _entries(node: CommentedSeq, file: Path) -> list[SourceLine]:
    if isinstance(node, JoinedList):
        return node.places
    return [SourceLine(file, node.lc.item(number)[0] + 1) for number in range(len(node))]
