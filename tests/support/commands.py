"""The command line as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-c", "from identification.cli import main; main()"]


def process(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """`servotwin`, in a session of its own; `env` is over the environment of now."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), **options.pop("env", {})}
    return subprocess.Popen(
        COMMAND + [str(argument) for argument in arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
        **options,
    )
