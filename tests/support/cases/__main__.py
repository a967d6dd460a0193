"""Runs what went wrong once, in a copy, and says what comes of it: `python -m tests.support.cases FOLDER [NAME...]`."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.support.cases import can, first_use, fits, fmi, live
from tests.support.cases.case import Case, verdict

CASES: dict[str, Case] = {**fmi.CASES, **can.CASES, **first_use.CASES, **fits.CASES, **live.CASES}


def main(arguments: Sequence[str] | None = None) -> int:
    """1 where a case comes out other than it should."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.cases", description=__doc__)
    parser.add_argument("folder", type=Path, help="with the folders fmi, can, first_use, fit and live")
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases, or folders of them; all by default")
    parsed = parser.parse_args(arguments)
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):  # ignored where a shell began this in the background
        signal.signal(number, signal.SIG_DFL)
    wrong = 0
    with tempfile.TemporaryDirectory() as aside:
        copy = Path(aside) / "cases"
        shutil.copytree(parsed.folder, copy)
        os.environ["HOME"] = aside
        os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        for name, case in CASES.items():
            if parsed.names and not any(name == wanted or name.startswith(f"{wanted}/") for wanted in parsed.names):
                continue
            found = verdict(copy / case.folder, case)
            wrong += found.wrong
            print(f"{name:45}{found.line}", flush=True)
    print(f"{wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
