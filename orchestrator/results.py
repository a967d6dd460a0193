"""Folders of results: written beside and renamed, with a manifest of what went in."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from fmus.errors import InputError
from fmus.json_document import json_text
from fmus.owned import MARK, owned_folder
from fmus.words import listed
from orchestrator.processes import last_words

PACKAGES = ("servotwin", "fmpy", "pythonfmu", "numpy", "scipy", "sympy", "control")
MARKS = ("manifest.json", "summary.json")
FAILURE = "the process that took the steps was gone before the end"
NOTE = "rescue.json"  # beside a record: the result that it would be
EARLIER = "earlier"  # in a hidden folder: the result whose place is taken
RECORD = ".written.json"  # in a result: its files and their sizes, so that what others put there is known; what of
CLAIM = "claim.json"  # in a hidden folder: what the result is made of
LEAST_FREE = 16 << 20  # bytes
_JUNK = {".DS_Store", "Thumbs.db", "desktop.ini"}  # that file managers leave


class CheckDocument(TypedDict):
    """How an expectation or a claim turned out; see `orchestrator.scenario.expectations.Check`.

    Attributes:
        needed: whether the case fails where it did not hold, which it does by default.
    """

    text: str
    held: bool
    found: str
    figure: NotRequired[float]
    margin: NotRequired[float]
    unit: NotRequired[str]
    needed: NotRequired[bool]
    doubt: NotRequired[str]
    parts: NotRequired[list[CheckDocument]]


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


@dataclass(frozen=True)
class Permission:
    """What may be replaced by results.

    Attributes:
        force: whether also what is no result, and results that hold files of others.
        inputs: what is read; no folder with one of them is replaced in any case.
    """

    force: bool = False
    inputs: tuple[Path, ...] = ()


_permission: ContextVar[Permission | None] = ContextVar("permission", default=None)


def permission() -> Permission:
    """That which holds now."""
    return _permission.get() or Permission()


@contextmanager
def permitted(given: Permission) -> Iterator[None]:
    """Have this permission hold for the block."""
    token = _permission.set(given)
    try:
        yield
    finally:
        _permission.reset(token)


@contextmanager
def result_folder(target: Path, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A folder to fill that becomes `target` when all went well; an earlier result there is replaced.

    Raises:
        InputError: see `aside`.
    """
    with aside(target, inputs, begins=False) as near:
        fresh = near / "fresh"
        fresh.mkdir()
        yield fresh
        files = {str(path.relative_to(fresh)): path.stat().st_size for path in fresh.rglob("*") if path.is_file()}
        place = target.resolve()
        write_json(fresh / RECORD, {"files": dict(sorted(files.items())), "of": _sources(place)})
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(target, error) from error
        _exchange(fresh, place, near / EARLIER)


@contextmanager
def aside(target: Path, inputs: Iterable[Path] = (), *, replaces: bool = True, begins: bool = True) -> Iterator[Path]:
    """A hidden folder on the disk that a result goes to, where it may go there; those that killed commands have left
    there go.

    Args:
        inputs: what the work reads, besides what the permission names.
        replaces: whether what is there goes, or is only added to.
        begins: whether the work is still to be done; where it is done, a disk that is nearly full is no reason.

    Raises:
        InputError: `target` is there and holds something that is no result of ours, or that others put beside one;
            or it is or contains the working folder or an input; or there is no writing there; or the disk is full.
    """
    place = _sound(target, inputs, replaces)
    hidden, near = f".{place.name}", next(parent for parent in place.parents if parent.exists())
    with ExitStack() as stack:
        try:
            for left in near.glob(f"{hidden}{MARK}*"):
                put_back(left)
            folder = stack.enter_context(owned_folder(near, hidden))
        except OSError as error:
            raise _unwritable(target, error) from error
        if begins and (free := shutil.disk_usage(folder).free) < LEAST_FREE:
            raise InputError(target, f"is on a disk with {free / 1e6:.0f} MB left", "make space, or give another --out")
        stack.enter_context(last_words.own().saying(last_words.LITTER, folder))
        with suppress(OSError):  # a full disk; whoever writes the result says so
            write_json(folder / CLAIM, {"of": _sources(place)})
        yield folder


def check_target(target: Path, inputs: Iterable[Path] = (), *, replaces: bool = True) -> None:
    """See that a result may be written there, before the work for it is done; as `aside`, which raises the same."""
    with aside(target, inputs, replaces=replaces):
        pass


def default_folder(file: Path, ending: str = "") -> Path:
    """Where the result of a file goes that is given no other place: `out/` and its name without the suffix.

    Raises:
        InputError: there is the result of another file of that name, or a command is making it.
    """
    target = Path("out") / f"{file.stem}{ending}"
    place, own = target.resolve(), file.resolve()
    claims = [one for near in place.parents[:2] for one in near.glob(f".{place.name}{MARK}*/{CLAIM}")]
    for record in (place / RECORD, *claims):
        others = [place.parent / one for one in _claimed(record)]
        if others and not any(other.resolve() == own for other in others):
            other = os.path.relpath(others[0].resolve())
            raise InputError(target, f"is the folder for the results of {other}, too", "give another --out")
    return target


def _sources(place: Path) -> list[str]:
    """The files that a result at this place is made of, as seen from the folder that it is in."""
    return [Path(os.path.relpath(file.resolve(), place.parent)).as_posix() for file in permission().inputs]


def _claimed(record: Path) -> list[str]:
    """What the result is made of that lies, or is to lie, beside this file; nothing where that is not known."""
    try:
        return [str(one) for one in json.loads(record.read_text(encoding="utf-8"))["of"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def put_back(hidden: Path) -> None:
    """Put an earlier result back that was taken away by a command which was killed before it put its own there.

    Args:
        hidden: the folder of that command beside the result.

    Raises:
        OSError: it cannot be moved.
    """
    earlier, place = hidden / EARLIER, hidden.with_name(hidden.name.partition(MARK)[0].removeprefix("."))
    if earlier.is_dir() and hidden.name.startswith(".") and not place.exists():
        earlier.rename(place)


def _unwritable(target: Path, error: OSError) -> InputError:
    return InputError(target, f"cannot be written ({error.strerror})", "give another --out")


def _sound(target: Path, inputs: Iterable[Path], replaces: bool) -> Path:
    """The place of a target that may hold a result."""
    place, allowed = target.resolve(), permission()
    if place.exists() and not place.is_dir():
        raise InputError(target, "is a file", "give another --out")
    if replaces:
        _spare(target, {Path.cwd(): "the working folder", Path.home(): "your home folder"})
        _spare(target, {path: f"{path}, which is read" for path in (*allowed.inputs, *inputs)})
    if place.is_dir() and any(place.iterdir()) and not allowed.force:
        if not any(_is_ours(place / mark) for mark in MARKS):
            raise InputError(target, "is not empty and holds no result", "give another --out, or --force to replace it")
        if replaces and (foreign := list(_foreign(place, place, _written(place)))):
            raise InputError(
                target,
                f"holds {listed(foreign, 1)}, which no command of ours wrote so",
                "move that away, give another --out, or --force to replace all",
            )
    return place


def _spare(target: Path, kept: Mapping[Path, str]) -> None:
    """Refuse a target that is one of these, or contains one."""
    for path, name in kept.items():
        found = path.resolve()
        if target.resolve() in (found, *found.parents):
            raise InputError(target, f"is or contains {name}", "give another --out")


def _written(folder: Path) -> dict[str, int]:
    """Name -> size of the files of a result, as it says itself."""
    try:
        files = json.loads((folder / RECORD).read_text(encoding="utf-8"))["files"]
        return {RECORD: (folder / RECORD).stat().st_size, **files}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _foreign(folder: Path, result: Path, written: Mapping[str, int]) -> Iterator[str]:
    """Files below a folder of a result that others wrote or changed, by their names in the result."""
    for path in sorted(folder.iterdir()):
        name = str(path.relative_to(result))
        if path.is_dir() and not path.is_symlink():
            own = _written(path)
            yield from (
                (str(path.relative_to(result) / other) for other in _foreign(path, path, own))
                if own
                else _foreign(path, result, written)
            )
        elif path.name not in _JUNK and name not in MARKS and written.get(name) != path.lstat().st_size:
            yield name


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
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 (slow to load)

    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def write_json(path: Path, document: object) -> None:
    """One JSON document; see `json_text`."""
    path.write_text(json_text(document), encoding="utf-8")


def prepare(near: Path, records: Sequence[str], target: Path, about: Mapping[str, Any]) -> None:
    """Say what is to become of a record, should its command be killed.

    Args:
        near: the folder of what is not yet a result.
        records: names that it has there, one after the other; the first that is there counts.
        about: what its manifest is to say.
    """
    note = {"records": list(records), "target": str(target.resolve()), "about": dict(about)}
    write_json(near / NOTE, note)


def rescue(near: Path) -> str:
    """Make a result of the record that lies there; what is to be said of it, "" where there is none to be made.

    Raises:
        OSError, InputError: it cannot be written.
    """
    try:
        note = json.loads((near / NOTE).read_text(encoding="utf-8"))
        target = Path(note["target"])
        records = [file for name in note["records"] if (file := near / name).is_file()]
        if not records or _is_there(target, near / NOTE):
            return ""
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    # it is opened first, for a new result sweeps away what dead commands have left
    with records[0].open("rb") as record, result_folder(target) as folder:
        name = f"run{records[0].suffix}"
        with (folder / name).open("wb") as copy:
            shutil.copyfileobj(record, copy)
        document = {"passed": False, "ended": "failed", "failure": FAILURE, "trace": name, "versions": versions()}
        write_json(folder / "manifest.json", note["about"] | document)
    (near / NOTE).unlink(missing_ok=True)
    return f"the result up to there is in {target}"


def _is_there(target: Path, note: Path) -> bool:
    """Whether the result was written before its command was killed."""
    manifest = target / "manifest.json"
    return manifest.is_file() and manifest.stat().st_mtime_ns > note.stat().st_mtime_ns
