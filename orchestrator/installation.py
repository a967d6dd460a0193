"""What is installed here, as a report of a fault has to tell it."""

from __future__ import annotations

import platform
import re
import subprocess
import sys
from importlib.metadata import requires

from fmus.errors import ModelError
from fmus.packaging import cache
from fmus.packaging.native import compiler
from orchestrator.engine import compiled
from orchestrator.results import version_of


def details() -> list[str]:
    """Versions of servotwin, Python and the libraries used, platform, compiler, what steps systems and where FMUs
    are kept; a line each."""
    used = (needed for needed in requires("servotwin") or [] if 'extra == "dev"' not in needed)
    names = {re.split(r"[^\w.-]", needed)[0] for needed in used}
    return [
        f"servotwin: {version_of('servotwin')}",
        f"Python: {platform.python_version()} ({platform.python_implementation()}, {sys.executable})",
        f"platform: {platform.platform()}, {platform.machine()}",
        f"compiler: {_compiler()}",
        f"stepping loop: {'compiled' if compiled.available() else f'in Python, {compiled.NOT_BUILT}'}",
        f"cache of FMUs: {kept.folder if (kept := cache.current()) else 'switched off'}",
        *(f"{name}: {version_of(name)}" for name in sorted(names)),
    ]


def _compiler() -> str:
    """The first line that the compiler for this machine says of itself."""
    try:
        command = compiler.command_for(compiler.host())
        said = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=30, check=False).stdout
    except (ModelError, OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return f"{' '.join(command)}, {said.partition(chr(10))[0]}"
