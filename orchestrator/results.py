"""Folders of results: written beside and renamed, with a manifest of what went in."""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from fmus.errors import InputError

PACKAGES = ("servotwin", "fmpy", "pythonfmu", "numpy", "scipy", "sympy", "control")
MARKS = ("manifest.json", "summary.json")


@contextmanager
def result_folder(target: Path) -> Iterator[Path]:
    """A folder to fill that becomes `target` when all went well; an earlier result there is replaced.

    Raises:
        InputError: `target` is there and holds something that is no result.
    """
    if target.exists() and not target.is_dir():
        raise InputError(target, "is a file", "give another --out")
    if target.is_dir() and any(target.iterdir()) and not any((target / mark).is_file() for mark in MARKS):
        raise InputError(target, "is not empty and holds no result", "give another --out")
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    fresh.chmod(0o755)
    try:
        yield fresh
        if target.exists():
            shutil.rmtree(target)
        fresh.rename(target)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def versions() -> dict[str, str]:
    """Version of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """One JSON document, floats with every bit, NaN refused."""
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
