"""Whose the parts of an FMU are: documentation/licenses, where FMI looks for it."""

from __future__ import annotations

from functools import cache
from importlib import metadata
from pathlib import Path

NAME = "documentation/licenses/license.txt"
_RUNTIME = """The model in this FMU is its author's. What runs it is part of servotwin, under these terms:

{servotwin}
"""
_HEADERS = """
The headers of FMI (sources/fmi*.h) are under the 2-Clause BSD License; their first lines say so and whose they are.
"""
_PYTHONFMU = """
resources/pythonfmu and the libraries in binaries are part of pythonfmu {version}, under these terms:

{terms}
"""


@cache
def native() -> bytes:
    """Of an FMU of generated C."""
    return (_runtime() + _HEADERS).encode()


@cache
def python() -> bytes:
    """Of an FMU that pythonfmu runs."""
    found = metadata.distribution("pythonfmu")
    terms = next(file.read_text() for file in found.files or () if file.name.upper().startswith("LICENSE"))
    return (_runtime() + _PYTHONFMU.format(version=found.version, terms=terms)).encode()


def _runtime() -> str:
    return _RUNTIME.format(servotwin=(Path(__file__).parent / "license.txt").read_text())
