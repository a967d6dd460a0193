"""Standard streams as shells give them: read in part, on a full disk, closed."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import COMMAND, ROOT

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """One of which more is to be told than a pipe takes up."""
    names = [f"s{number}" for number in range(1000)]
    path = tmp_path / "log.csv"
    path.write_text("".join(f"{','.join(row)}\n" for row in (["time", *names], ["0"] * 1001, ["1"] * 1001)))
    return path


def shell(line: str, recording: Path) -> tuple[int, str]:
    """Exit code and standard error of a line, in which `info` tells of the recording."""
    script = f'info() {{ {shlex.join(COMMAND)} trace info "$@"; }}\n{line}'
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=recording.parent,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        check=False,
        text=True,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize("options", ["", "--json"])
def test_whoever_has_read_enough_is_no_failure(recording: Path, options: str) -> None:
    assert shell(f"info log.csv {options} | head -n 1; exit ${{PIPESTATUS[0]}}", recording) == (0, "")


@pytest.mark.parametrize("closed", ["2>&-", "<&-", ">&- 2>&- <&-"])
def test_closed_streams_change_no_exit_code_of_what_needs_none(recording: Path, closed: str) -> None:
    assert shell(f"info log.csv -q {closed}", recording) == (0, "")
    code, said = shell(f"info none.csv {closed}", recording)
    assert code == 2
    assert ("none.csv: there is no such file" in said) == ("2" not in closed)


@pytest.mark.parametrize("where", ["2> /dev/full", "2> >(exec true)"])
def test_a_command_goes_on_where_nobody_takes_what_it_tells_meanwhile(recording: Path, where: str) -> None:
    """One that has a bus, or prints in an FMU, would end in the middle of its work."""
    record = shlex.join([*COMMAND, "can", "record", "--interface", "virtual", "--channel", "streams", "--out", "taken"])
    assert shell(f"{record} --json --duration 1.5 {where}", recording) == (0, "")
    assert json.loads((recording.parent / "taken/manifest.json").read_text())["ended"] == "duration"


CLOSED, FULL = ("Bad file descriptor", ">&-"), ("No space left on device", "> /dev/full")


@pytest.mark.parametrize(("why", "where"), [CLOSED, FULL])
@pytest.mark.parametrize("options", ["log.csv", "log.csv --json", "--help"])
def test_output_that_cannot_be_written_is_told(recording: Path, options: str, why: str, where: str) -> None:
    code, said = shell(f"info {options} {where}", recording)
    assert code == 2
    assert said.splitlines() == [f"servotwin: standard output: cannot be written ({why}); send it elsewhere"]


@pytest.mark.parametrize(("why", "where"), [CLOSED, FULL])
def test_what_was_wrong_before_output_could_not_be_written_is_told_first(recording: Path, why: str, where: str) -> None:
    code, said = shell(f"info none.csv --json {where}", recording)
    assert code == 2
    first, second = said.splitlines()
    assert "none.csv: there is no such file" in first
    assert second == f"servotwin: standard output: cannot be written ({why}); send it elsewhere"
