"""FMU files with something in them changed, and how they are refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from fmus.errors import FmuFileError
from fmus.packaging import archive
from orchestrator.fmi.file import FmuFile

XML = "modelDescription.xml"


def changed(source: Path, target: Path, change: Callable[[dict[str, bytes]], Mapping[str, bytes]]) -> Path:
    archive.write(target, change(archive.read(source)))
    return target


def without_dependencies(files: dict[str, bytes]) -> dict[str, bytes]:
    return {**files, XML: re.sub(rb' dependencies="[^"]*"', b"", files[XML])}


def with_xml(source: Path, target: Path, *replacements: tuple[str, str]) -> Path:
    def change(files: dict[str, bytes]) -> dict[str, bytes]:
        text = files[XML].decode()
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        return {**files, XML: text.encode()}

    return changed(source, target, change)


def refusal(path: Path) -> str:
    """The message with which a file is refused, seen to be one line that names the file."""
    with pytest.raises(FmuFileError) as refused:
        FmuFile(path)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message.removeprefix(str(path))
