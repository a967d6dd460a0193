"""Environments of their own for tools that cannot live in ours."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CACHE = Path(__file__).parents[2] / ".cache"


def python_with(name: str, *packages: str) -> str:
    """The interpreter of the environment of this name, made anew unless its packages were installed to the end.

    Raises:
        CalledProcessError: they cannot be installed.
    """
    folder = CACHE / name
    python, ready = folder / "bin" / "python", folder / "ready"
    if not ready.exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "-q", *packages], check=True, capture_output=True)
        ready.touch()
    return str(python)
