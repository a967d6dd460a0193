"""Folders of results: written beside and renamed, with a manifest of what went in."""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from fmus.errors import InputError

PACKAGES = ("servotwin", "fmpy", "pythonfmu", "numpy", "scipy", "sympy", "control")
MARKS = ("manifest.json", "summary.json")


class CheckDocument(TypedDict):
    """How an expectation or a claim turned out."""

    text: str
    held: bool
    found: str


class CaseDocument(TypedDict):
    """How a case of a file turned out.

    Attributes:
        output: what a command said.
    """

    name: str
    passed: bool
    error: str | None
    checks: list[CheckDocument]
    seconds: NotRequired[float]
    output: NotRequired[str]


class FileDocument(TypedDict):
    """How a file of the regression suite turned out, and the folder with its results."""

    title: str
    passed: bool
    out: str
    cases: Sequence[CaseDocument]


@contextmanager
def result_folder(target: Path) -> Iterator[Path]:
    """A folder to fill that becomes `target` when all went well; an earlier result there is replaced.

    Raises:
        InputError: `target` is there and holds something that is no result of ours, or cannot be written.
    """
    place = target.resolve()
    try:
        check_target(target)
        place.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    except OSError as error:
        raise InputError(target, f"cannot be written ({error.strerror})", "give another --out") from error
    fresh, earlier = aside / "fresh", aside / "earlier"
    fresh.mkdir()
    try:
        yield fresh
        _exchange(fresh, place, earlier)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def check_target(target: Path) -> None:
    """See that a result may be written there, before the work for it is done.

    Raises:
        InputError: `target` is there and holds something that is no result of ours.
    """
    place = target.resolve()
    if place.exists() and not place.is_dir():
        raise InputError(target, "is a file", "give another --out")
    if place.is_dir() and any(place.iterdir()) and not any(_is_ours(place / mark) for mark in MARKS):
        raise InputError(target, "is not empty and holds no result", "give another --out")


def _is_ours(mark: Path) -> bool:
    """Whether a file says that it comes from us: other programs have a manifest.json, too."""
    try:
        return "servotwin" in json.loads(mark.read_text(encoding="utf-8"))["versions"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _exchange(fresh: Path, target: Path, earlier: Path) -> None:
    """Put `fresh` where `target` is; where that fails, what was there is put back."""
    if not target.exists():
        fresh.rename(target)
        return
    target.rename(earlier)
    try:
        fresh.rename(target)
    except BaseException:
        earlier.rename(target)
        raise


def versions() -> dict[str, str]:
    """Version of Python and of the packages that results depend on."""
    return {"python": platform.python_version()} | {name: version_of(name) for name in PACKAGES}


@cache
def version_of(package: str) -> str:
    """Its version, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """One JSON document, floats with every bit, NaN refused."""
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
