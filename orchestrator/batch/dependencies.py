"""What a YAML file of the suite depends on: files that it names, and those that these name."""

from __future__ import annotations

import shlex
from collections.abc import Container, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from fmus import library
from orchestrator.yaml_file import contents


def dependencies(path: Path, gone: Container[Path] = ()) -> set[Path]:
    """The file and, of what it names, those files that are there: other YAML files and all that they name, recordings,
    FMUs, models (of the library, too), databases.

    Args:
        gone: files that are no longer there, and count as if they were.

    Raises:
        ScenarioError: a YAML file among them cannot be read.
    """
    found: set[Path] = set()
    left = [path.resolve()]
    while left:
        file = left.pop()
        if file not in found:
            found.add(file)
            left += _named(file, gone) if file.suffix in (".yaml", ".yml") and file.is_file() else []
    return found


def _named(file: Path, gone: Container[Path]) -> list[Path]:
    named = [one for key, text in _texts("", contents(file)) for one in _files(file.parent, key, text)]
    return [one.resolve() for one in named if _is_file(one) or one.resolve() in gone]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a text that is too long for a name
        return False


def _texts(key: str, node: Any) -> Iterator[tuple[str, str]]:
    """Every text below a node of a document, with the key that it stands at."""
    if isinstance(node, dict):
        for name, inner in node.items():
            yield from _texts(str(name), inner)
    elif isinstance(node, list):
        for inner in node:
            yield from _texts(key, inner)
    elif isinstance(node, str):
        yield key, node


def _files(base: Path, key: str, text: str) -> Iterator[Path]:
    """What files a text may name: a model of the library, those of a pattern, or by itself or a word of a command."""
    if key == "model" and (file := library.file_of(text)) is not None:
        yield file
    elif key == "files":
        with suppress(ValueError, NotImplementedError, OSError):  # no pattern
            yield from base.glob(text)
    else:
        yield from (base / word.replace("{here}", str(base)) for word in (text, *_words(text)) if word)


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError:  # an apostrophe
        return text.split()
