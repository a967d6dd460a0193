"""`servotwin run --live` as a user meets it: keys on a terminal, a watched file, and what is left of the changes."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from orchestrator import formats
from orchestrator.cli.terminal import WIDE
from tests.support.commands import COMMAND

if sys.platform != "win32":
    import pty

SCENARIO = """\
title: A motor turned by hand
components:
  motor: {model: dc_motor}
  hand: {model: pendulum}
connections:
  - motor.torque -> hand.torque
  - hand.speed -> motor.speed
run: {stop: 4, step: 0.01}
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no such terminals")
def test_a_key_changes_a_value_and_the_manifest_and_the_trace_say_when(tmp_path: Path) -> None:
    (tmp_path / "motor.yaml").write_text(SCENARIO)
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(tmp_path)
        os.environ |= {"TERM": "xterm", "COLUMNS": str(WIDE)}
        os.execv(sys.executable, [*COMMAND, "run", "motor.yaml", "--live", "--out", "result"])
    said, typed, until = b"", False, time.monotonic() + 300
    while time.monotonic() < until:
        if select.select([terminal], [], [], 0.5)[0]:
            try:
                said += os.read(terminal, 4096)
            except OSError:  # it has ended
                break
        if not typed and "▸ motor.voltage".encode() in said:
            os.write(terminal, b"0.5\r")
            typed = True
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0, said.decode(errors="replace")
    for expected in ("hand.angle", "late steps", "times real time", "0.5 V"):
        assert expected in said.decode(errors="replace")
    [case] = json.loads((tmp_path / "result" / "manifest.json").read_text())["cases"]
    [change] = case["changes"]
    assert (change["name"], change["before"], change["value"], change["by"]) == ("motor.voltage", 0.0, 0.5, "keys")
    assert case["deadlines"]["steps"] == 400
    voltage = formats.read(tmp_path / "result" / case["trace"]).trace["motor.voltage"]
    assert [*voltage] == [0.0] * change["step"] + [0.5] * (401 - change["step"])
    assert "motor.voltage" in (tmp_path / "result" / "report.html").read_text()


@pytest.mark.slow
def test_options_of_live_runs_go_with_live(tmp_path: Path) -> None:
    (tmp_path / "motor.yaml").write_text(SCENARIO)
    for more, problem in [
        (["--tune", "motor.voltage"], "--tune: is for runs in real time; give --live, too"),
        (["--changes", "x"], "--changes: is for runs in real time; give --live, too"),
        (["--live", "--tune", "motor.speed"], "motor.speed: is driven by something else"),
        (["--live", "--changes", "x.txt"], "x.txt: cannot be read"),
    ]:
        run = [*COMMAND, "run", "motor.yaml", *more]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and problem in done.stderr and done.stderr.count("\n") == 1, done.stderr
