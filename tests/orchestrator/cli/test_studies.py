"""Studies on the command line: what is shown, answered and left, and what an interrupt leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from orchestrator.processes.pool import at_most
from tests.support.commands import ROOT, only_json, process, servotwin
from tests.support.identification.small_study import record, write_study

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the small study, its data, and its calibration in `out`."""
    folder = tmp_path_factory.mktemp("rig")
    data, out = record(folder / "data"), folder / "out"
    with at_most(1):
        answer = servotwin("calibrate", write_study(folder / "study.yaml"), "--data", data, "--out", out, "--json")
    assert only_json(answer) == json.loads((out / "summary.json").read_text())
    return folder


def test_quiet_commands_say_nothing(rig: Path, scenario: Path, tmp_path: Path) -> None:
    recording = rig / "data" / "rig_0__a.csv"
    for arguments in (
        ["build", "pendulum", "--target", "python", "--out", tmp_path / "f"],
        ["run", scenario],
        ["validate", rig / "out", "--data", rig / "data", "--out", tmp_path / "v"],
        ["trace", "info", recording],
        ["trace", "convert", recording, tmp_path / "a.parquet"],
        ["trace", "plot", recording, "--out", tmp_path / "a.html"],
        ["info", rig / "out"],
    ):
        answer = servotwin(*arguments, "-q")
        assert (answer.exit_code, answer.stdout, answer.stderr) == (0, "", ""), arguments


def test_a_calibration_is_shown_as_a_table_with_fits_and_where_it_is(rig: Path, tmp_path: Path) -> None:
    answer = servotwin("calibrate", rig / "study.yaml", "--data", rig / "data", "--out", tmp_path / "c")
    assert answer.exit_code == 0
    for word in (
        "hand.inertia",
        "true",
        "estimate",
        "median FIT, train: 0.99",
        "median FIT, validation: 0.99",
        "(1 trace)",
    ):
        assert word in answer.stdout
    assert f"FMUs in {tmp_path / 'c' / 'fmus'}, report in {tmp_path / 'c' / 'report.html'}" in answer.stdout


def test_validate_answers_with_the_verdict(rig: Path, tmp_path: Path) -> None:
    document = only_json(servotwin("validate", rig / "out", "--data", rig / "data", "--out", tmp_path / "v", "--json"))
    assert document["held"] and document == json.loads((tmp_path / "v" / "summary.json").read_text())


def test_info_answers_about_fmus_traces_and_results(rig: Path) -> None:
    fmu = only_json(servotwin("info", rig / "out" / "fmus" / "hand.fmu", "--json"))
    trace = only_json(servotwin("info", rig / "data" / "rig_0__a.csv", "--json"))
    result = only_json(servotwin("info", rig / "out", "--json"))
    assert fmu["calibrated by"] == "A small rig (output-error)"
    assert [signal["name"] for signal in trace["signals"]] == ["voltage", "angle"]
    assert "report.html" in result["files"] and result["method"] == "output-error"
    assert "hand.inertia" in servotwin("info", rig / "out").stdout


def _unpacked(scratch: Path) -> bool:
    """Whether an FMU has been unpacked there."""
    try:
        return any(True for _ in scratch.rglob("servotwin-fmu-*"))
    except FileNotFoundError:  # of a folder that has just been removed
        return False


def interrupted(tmp_path: Path, group: bool, *arguments: object) -> tuple[int, str, str]:
    """Exit code and outputs of a command that is interrupted while its FMUs run."""
    scratch = tmp_path / "scratch"
    scratch.mkdir(exist_ok=True)
    running = process(*arguments, env={"TMPDIR": str(scratch)})
    deadline = time.monotonic() + 60
    while not _unpacked(scratch) and time.monotonic() < deadline and running.poll() is None:
        time.sleep(0.01)
    time.sleep(0.3)
    assert running.poll() is None, running.communicate()
    (os.killpg if group else os.kill)(running.pid, signal.SIGINT)
    stdout, stderr = running.communicate(timeout=120)
    assert list(scratch.iterdir()) == []
    return running.returncode, stdout, stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
@pytest.mark.parametrize("group", [False, True], ids=["alone", "as a terminal does"])
def test_an_interrupted_calibration_leaves_nothing(tmp_path: Path, group: bool) -> None:
    record(tmp_path / "data")
    study = write_study(
        tmp_path / "study.yaml",
        options={"starts": 5000},
        parameters={
            "hand.inertia": {"start": 0.006, "min": 0.001, "max": 0.02},
            "hand.gravity_torque": {"start": 0.03, "min": 0.01, "max": 0.2},
        },
    )
    ended = interrupted(
        tmp_path, group, "calibrate", study, "--data", tmp_path / "data", "--out", tmp_path / "out" / "c"
    )
    assert ended[:2] == (130, "")
    assert ended[2] in ("interrupted\n", "interrupted before anything was estimated; nothing is written\n")
    assert list((tmp_path / "out").rglob("*")) == []


MEASURED = """
import resource, sys
from identification.cli import main
try:
    main()
finally:  # the peak that getrusage tells of this process is at least the memory of the one that started it
    own = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print("peaks", own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr)
"""


@pytest.mark.slow
def test_the_real_calibration_reaches_its_figures(butterfly_data: Path, tmp_path: Path) -> None:
    """Median FIT of recordings not used at least 0.94, below 1 GB with two processes."""
    script = tmp_path / "measured.py"
    script.write_text(f"if __name__ == '__main__':\n{''.join('    ' + line for line in MEASURED.splitlines(True))}")
    study, out = ROOT / "scenarios" / "butterfly" / "calibration.yaml", tmp_path / "out"
    command = [sys.executable, script, "calibrate", study, "--data", butterfly_data, "--out", out, "--json"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout, parse_constant=pytest.fail)
    assert document["fit"]["validation"]["median"] >= 0.94
    assert 0.3 < document["fit"]["compared"]["thesis, Table 5"]["median"] < 0.6
    assert len(document["fit"]["validation"]["traces"]) == 9
    own, largest_child = map(int, done.stderr.split("peaks")[1].split())
    assert (own + 2 * largest_child) * 1024 < 1e9  # as on two processors
    held_out = butterfly_data / "Data_154__7__001.mat"
    verdict = only_json(servotwin("validate", tmp_path / "out", "--data", held_out, "--out", tmp_path / "v", "--json"))
    assert verdict["held"] and verdict["fit"]["unseen"]["median"] >= 0.94
