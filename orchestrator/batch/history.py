"""What failed the last time that the suite ran into a folder."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from fmus.errors import InputError
from fmus.files import atomic_write

FILE = "verdicts.json"


def remember(passed: Mapping[Path, bool], out: Path) -> None:
    """Keep in a folder of the suite's results which files passed; what is known of others there stays."""
    known = {**_known(out), **{str(file.resolve()): held for file, held in passed.items()}}
    there = {file: held for file, held in known.items() if Path(file).exists()}
    atomic_write(out / FILE, (json.dumps({"passed": there}, indent=2, sort_keys=True) + "\n").encode())


def failed(files: Iterable[Path], out: Path) -> list[Path]:
    """Those of the files that failed when the suite last ran them into this folder.

    Raises:
        InputError: it has run none of them there.
    """
    known, asked = _known(out), list(files)
    if not any(str(file.resolve()) in known for file in asked):
        raise InputError("--failed", f"none of the files has been run into {out} yet", "run without --failed first")
    return [file for file in asked if known.get(str(file.resolve())) is False]


def _known(out: Path) -> dict[str, bool]:
    """File -> whether it passed; nothing where the folder does not say."""
    try:
        passed = json.loads((out / FILE).read_text(encoding="utf-8"))["passed"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return {file: held for file, held in passed.items() if isinstance(held, bool)} if isinstance(passed, dict) else {}
