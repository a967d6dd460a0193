"""Every file can be imported where the modules of Unix are not; .ci/run checks types for other platforms, too."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OF_UNIX = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
FILES = [file for package in ("fmus", "orchestrator", "identification") for file in (ROOT / package).rglob("*.py")]


def imported(source: str) -> set[str]:
    """What a file imports whatever the platform."""
    found = set[str]()
    for node in ast.parse(source).body:
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import os, fcntl", {"os", "fcntl"}),
        ("from termios import TCSANOW", {"termios"}),
        ("import sys\nif sys.platform != 'win32':\n    import fcntl", {"sys"}),
    ],
)
def test_an_import_counts_where_nothing_stands_before_it(source: str, found: set[str]) -> None:
    assert imported(source) == found


def test_no_file_imports_what_only_unix_has_without_asking() -> None:
    wrong = {str(file.relative_to(ROOT)): imported(file.read_text()) & OF_UNIX for file in FILES}
    assert {name: modules for name, modules in wrong.items() if modules} == {}
