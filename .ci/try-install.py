"""Use an installed servotwin as on the first day: its version, a scenario of its own, two models as FMUs.

    python .ci/try-install.py

Exit code 1 names the command that failed. The commands are those beside this interpreter, run in an empty folder.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

COMMANDS = (
    "--version -v",
    "init scenario",
    "run scenario.yaml --out run",
    "info run",
    "build pendulum dc_motor --out fmus",
)


def main() -> None:
    """Run the commands one after another."""
    program = shutil.which("servotwin", path=Path(sys.executable).parent)
    if program is None:
        sys.exit(f"servotwin is not installed beside {sys.executable}")
    with tempfile.TemporaryDirectory() as folder:
        for words in COMMANDS:
            print(f"$ servotwin {words}", flush=True)
            if subprocess.run([program, *words.split()], cwd=folder, check=False).returncode:
                sys.exit(f"servotwin {words} failed")
    print("the stepping loop is", "compiled" if find_spec("orchestrator.engine._compiled") else "run by Python")


if __name__ == "__main__":
    main()
