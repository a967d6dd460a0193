"""The traces in a folder of results: of a run, or of all runs of a suite."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from fmus.errors import InputError

MANIFEST = "manifest.json"


class CaseEntry(TypedDict, total=False):
    """A case in a manifest; one that gave no trace names none."""

    __pydantic_config__ = ConfigDict(extra="ignore")  # type: ignore[misc]
    name: str
    trace: str


class RunManifest(TypedDict):
    """What is read of the manifest of a run."""

    __pydantic_config__ = ConfigDict(extra="ignore")  # type: ignore[misc]
    cases: list[CaseEntry]


def traces(folder: Path) -> dict[str, Path]:
    """Name of a case -> the file with its trace; in the folder of a suite `scenario: case`.

    Raises:
        InputError: there is no manifest of a run, or one that is not to be understood.
    """
    if (folder / MANIFEST).is_file():
        return _traces(folder)
    runs = sorted(file.parent for file in folder.glob(f"*/*/{MANIFEST}"))
    if not runs:
        raise InputError(folder, "holds no manifest.json of a run", "give a folder that `run` or `test` wrote")
    return {
        f"{run.relative_to(folder).as_posix()}: {name}": file for run in runs for name, file in _traces(run).items()
    }


def _traces(folder: Path) -> dict[str, Path]:
    try:
        text = (folder / MANIFEST).read_text(encoding="utf-8")
        manifest = TypeAdapter(RunManifest).validate_python(json.loads(text))
    except (OSError, ValueError, RecursionError):
        raise InputError(folder / MANIFEST, "is not of a run", "give a folder that `run` or `test` wrote") from None
    found = {}
    for case in manifest["cases"]:
        if "name" in case and "trace" in case:
            if Path(case["trace"]).name != case["trace"]:
                raise InputError(folder, f"names the trace '{case['trace']}', which is not in it", "run it again")
            found[case["name"]] = folder / case["trace"]
    return found
