"""The command line, in this process and as one of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from identification.cli import app

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-c", "from identification.cli import main; main()"]


def servotwin(*arguments: object, **options: Any) -> Result:
    """The command in this process; `options` are those of `CliRunner.invoke`."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments], **options)


def only_json(answer: Result, code: int = 0) -> dict[str, Any]:
    """The one document on standard output, and nothing on standard error."""
    assert answer.exit_code == code, answer.stderr
    assert answer.stderr == ""
    document: dict[str, Any] = json.loads(answer.stdout, parse_constant=pytest.fail)
    return document


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
