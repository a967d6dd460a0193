"""What a Python program does to memory that is not its own, as valgrind tells it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

needs_valgrind = pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")


def memory_errors(program: str, folder: Path) -> str:
    """What valgrind writes of a program that ends with 0; the folder is for its file."""
    log = folder / "memory.txt"
    command = ["valgrind", "--error-limit=no", f"--log-file={log}", sys.executable, "-c", program]
    subprocess.run(command, env=os.environ | {"PYTHONMALLOC": "malloc"}, capture_output=True, timeout=300, check=True)
    found = log.read_text()
    assert "ERROR SUMMARY" in found
    return found
