"""The command line: documents for machines, silence on demand, exit codes, and an end when asked for one."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from typer.main import get_command
from typer.testing import CliRunner, Result

from fmus.packaging import targets
from identification.cli import app
from identification.output_error import calibration
from orchestrator import formats
from orchestrator.engine import compiled
from orchestrator.trace import Trace
from tests.support.commands import process
from tests.support.identification.small_study import record, write_study

ROOT = Path(__file__).parents[3]
STUDIES = ROOT / "scenarios" / "butterfly"
SCENARIO: dict[str, Any] = {
    "title": "A swing",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},
    "run": {"stop": 0.2, "step": 0.01},
    "expect": [{"signal": "hand.angle", "below": 0.6}],
}


def servotwin(*arguments: object) -> Result:
    """The command in this process."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def only_json(answer: Result, code: int = 0) -> dict[str, Any]:
    """The one document on standard output, and nothing on standard error."""
    assert answer.exit_code == code, answer.stderr
    assert answer.stderr == ""
    document: dict[str, Any] = json.loads(answer.stdout, parse_constant=pytest.fail)
    return document


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    return write_scenario(tmp_path)


def write_scenario(folder: Path, **changes: Any) -> Path:
    path = folder / "swing.yaml"
    path.write_text(json.dumps(SCENARIO | changes))
    return path


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the small study, its data, and its calibration in `out`."""
    folder = tmp_path_factory.mktemp("rig")
    record(folder / "data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "processors", lambda: 1)
        document = only_json(
            servotwin(
                "calibrate",
                write_study(folder / "study.yaml"),
                "--data",
                folder / "data",
                "--out",
                folder / "out",
                "--json",
            )
        )
    assert document == json.loads((folder / "out" / "summary.json").read_text())
    return folder


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Simulate here, and leave nothing in the working directory."""
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    monkeypatch.chdir(tmp_path)


def commands() -> list[list[str]]:
    """Every command, those of groups with their group."""
    top = get_command(app).commands  # type: ignore[attr-defined]
    return [[name] for name in top] + [[name, sub] for name in top for sub in getattr(top[name], "commands", {})]


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_every_command_explains_itself(command: list[str]) -> None:
    answer = servotwin(*command, "--help")
    assert answer.exit_code == 0 and answer.stderr == ""
    if not any(other[:-1] == command for other in commands()):  # no group
        assert all(option in answer.stdout for option in ("--json", "--quiet", "--verbose"))


def test_the_commands_that_scripts_depend_on_are_there() -> None:
    assert {" ".join(command) for command in commands()} >= {
        "build",
        "run",
        "calibrate",
        "validate",
        "info",
        "trace info",
        "trace convert",
        "trace plot",
    }


@pytest.mark.parametrize(
    "arguments", [["--frobnicate"], ["run", "--frobnicate"], ["frobnicate"], ["run"], ["validate", "x"]]
)
def test_a_command_line_that_is_none_has_exit_code_2(arguments: list[str]) -> None:
    answer = servotwin(*arguments)
    assert answer.exit_code == 2 and answer.stdout == "" and "Traceback" not in answer.stderr


def test_the_version_is_one_line_and_with_v_what_a_report_of_a_fault_needs() -> None:
    assert servotwin("--version").stdout == f"servotwin {version('servotwin')}\n"
    answer = servotwin("--version", "-v")
    told = dict(line.split(": ", 1) for line in answer.stdout.splitlines())
    assert answer.exit_code == 0 and answer.stderr == ""
    assert set(told) >= {
        "servotwin",
        "Python",
        "platform",
        "compiler",
        "stepping loop",
        "cache of FMUs",
        "numpy",
        "fmpy",
        "typer",
    }
    assert told["numpy"] == np.__version__ and told["Python"].startswith(platform.python_version())
    assert told["stepping loop"].startswith("compiled") == compiled.available()


def test_the_only_option_before_a_command_is_version() -> None:
    for arguments in (["-v"], ["-v", "info", "x"]):
        answer = servotwin(*arguments)
        assert answer.exit_code == 2 and "-v goes after it" in answer.stderr


def test_build_makes_valid_fmus_and_names_them(tmp_path: Path) -> None:
    document = only_json(servotwin("build", "pendulum", "daq", "--target", "python", "--out", tmp_path / "f", "--json"))
    assert set(document["fmus"]) == {"pendulum", "daq"} and document["target"] == "python"
    for file in document["fmus"].values():
        assert validate_fmu(file) == []


def test_build_refuses_a_model_that_is_not_there_with_those_there_are(tmp_path: Path) -> None:
    answer = servotwin("build", "pendulom", "--out", tmp_path / "f")
    assert answer.exit_code == 2 and "model 'pendulom': is not in the library; choose one of" in answer.stderr
    assert "pendulum" in answer.stderr and not (tmp_path / "f").exists()


def test_run_answers_with_what_its_folder_holds(scenario: Path, tmp_path: Path) -> None:
    document = only_json(servotwin("run", scenario, "--out", tmp_path / "out", "--json"))
    assert document == json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert document["passed"] and document["cases"][0]["checks"][0]["held"]


def test_run_has_exit_code_1_when_an_expectation_fails_and_still_leaves_its_folder(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, expect=[{"signal": "hand.angle", "below": 0.4}])
    assert only_json(servotwin("run", scenario, "--out", tmp_path / "out", "--json"), code=1)["passed"] is False
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 1 and "NO" in answer.stdout and "largest 0.5 rad" in answer.stdout
    assert (tmp_path / "out" / "run.parquet").is_file()


def test_set_goes_over_the_file(scenario: Path, tmp_path: Path) -> None:
    answer = servotwin(
        "run",
        scenario,
        "--out",
        tmp_path / "out",
        "--set",
        "hand.angle_start=0.25",
        "--set",
        "hand.inertia=4e-3",
        "--json",
    )
    assert only_json(answer)["overrides"] == {"hand.angle_start": 0.25, "hand.inertia": 0.004}
    assert formats.read(tmp_path / "out" / "run.parquet").trace["hand.angle"][0] == 0.25


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("hand.angel_start=1", "no variable 'angel_start' in 'hand'; did you mean 'angle_start'?"),
        ("hnad.angle_start=1", "no component 'hnad'; did you mean 'hand'?"),
        ("hand.inertia=-1", "hand.inertia: is -1, outside its bounds [0, inf)"),
        ("hand.inertia=nan", "hand.inertia: is nan; give a finite number"),
        ("hand.angle_start", "--set hand.angle_start: has no value; write component.variable=value"),
        ("hand.angle=1", "hand.angle: is an output and cannot be set"),
    ],
)
def test_a_set_that_does_not_fit_is_refused_in_one_line(
    scenario: Path, tmp_path: Path, override: str, problem: str
) -> None:
    answer = servotwin("run", scenario, "--out", tmp_path / "out", "--set", override, "--json")
    failed = json.loads(answer.stdout)["error"]
    assert answer.exit_code == failed["exit_code"] == 2 and set(failed) == {"place", "problem", "fix", "exit_code"}
    (line,) = answer.stderr.splitlines()
    assert problem in line and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_running_twice_gives_the_same_bytes_in_every_trace(tmp_path: Path) -> None:
    cases = [{"name": "low"}, {"name": "high", "set": {"hand.angle_start": 0.55}}]
    drive = {"drive": {"model": "excitation", "parameters": {"shape": "random", "seed": 4, "amplitude": 0.01}}}
    scenario = write_scenario(
        tmp_path, cases=cases, components=SCENARIO["components"] | drive, connections=["drive.signal -> hand.torque"]
    )
    for name in ("one", "two"):
        assert servotwin("run", scenario, "--out", tmp_path / name, "-q").exit_code in (0, 1)
    for name in ("low.parquet", "high.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert np.ptp(formats.read(tmp_path / "one" / "low.parquet").trace["drive.signal"]) > 0


def test_verbose_shows_whose_time_it_was_over_all_cases(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, cases=[{"name": "one"}, {"name": "two"}])
    answer = servotwin("run", scenario, "--out", tmp_path / "out", "-v", "--stride", "5")
    rows = {line.split("│")[1].strip(): line.split("│") for line in answer.stdout.splitlines() if line.count("│") == 6}
    assert rows["hand"][2].strip() == rows["(the loop itself)"][2].strip() == "40"
    assert float(rows["hand"][5]) + float(rows["(the loop itself)"][5]) == pytest.approx(100, abs=0.11)
    assert "40 steps of 0.01 s in " in answer.stdout and "recorded every 5 steps" in answer.stdout


def test_results_never_replace_what_is_no_result(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious.txt").write_text("mine")
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "is not empty and holds no result; give another --out" in answer.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["precious.txt"]
    assert servotwin("run", scenario, "--out", tmp_path / "out", "--force").exit_code == 0
    (tmp_path / "out" / "notes.txt").write_text("mine")
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "holds notes.txt, which no command of ours wrote" in answer.stderr
    answer = servotwin("run", scenario, "--out", tmp_path, "--force")
    assert answer.exit_code == 2 and "is or contains the working folder; give another --out" in answer.stderr
    assert scenario.is_file() and (tmp_path / "out" / "notes.txt").is_file()


def test_results_go_to_out_by_default(scenario: Path, tmp_path: Path) -> None:
    assert servotwin("run", scenario, "-q").exit_code == 0
    assert (tmp_path / "out" / "swing" / "manifest.json").is_file()


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
        "(1 traces)",
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


def test_square_brackets_are_shown_as_they_are(tmp_path: Path) -> None:
    """They stand in units and paths, and would be markup to the library that prints."""
    folder = tmp_path / "[" / "bold] [red]"
    folder.mkdir(parents=True)
    scenario = write_scenario(folder, title="[/i] in [rad]")
    answer = servotwin("run", scenario, "--out", folder / "out")
    assert answer.exit_code == 0, answer.stderr
    assert "[/i] in [rad]" in answer.stdout and f"results in {folder / 'out'}" in answer.stdout
    answer = servotwin("run", folder / "none[red].yaml")
    assert answer.exit_code == 2 and "none[red].yaml: no such file" in answer.stderr
    assert (
        "virtual:a:"
        in servotwin(
            "can", "replay", folder / "no.log", "--interface", "virtual", "--channel", "a", "--data-bitrate", 1
        ).stderr
    )


def test_a_terminal_obeys_no_name_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [s],\x1b[31mred\x1b]0;own\x07\x9b2J\u202etxt [V]\n0,1\n1,2\n")
    told = servotwin("info", tmp_path / "a.csv").stdout
    assert "\\x1b[31mred\\x1b]0;own\\x07\\x9b2J\\u202etxt" in told
    refused = servotwin("trace", "convert", tmp_path / "a.csv", tmp_path / "\x1b[2J.xyz").stderr
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & {*told, *refused} and len(refused.splitlines()) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes with names")
@pytest.mark.parametrize("name", ["a.csv", "a.yaml", "a.fmu", "a.blf", "a.log", "a.mat", "a.parquet"])
def test_a_pipe_is_no_file(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for command in (["info"], ["run"], ["calibrate"], ["trace", "info"], ["trace", "plot"]):
        answer = servotwin(*command, tmp_path / name)
        assert answer.exit_code == 2 and len(answer.stderr.splitlines()) == 1, answer.stderr


def test_what_nobody_foresaw_is_one_line_and_a_code_of_its_own(scenario: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("no such thing")

    monkeypatch.setattr("orchestrator.scenario.run.run_scenario", broken)
    answer = servotwin("run", scenario)
    assert answer.exit_code == 4 and answer.stdout == ""
    assert answer.stderr == (
        "servotwin: a fault of servotwin: KeyError: 'no such thing'; run with -vv and report what that says\n"
    )
    assert "Traceback" in servotwin("run", scenario, "-vv").stderr


def test_traces_are_described_converted_and_plotted(rig: Path, tmp_path: Path) -> None:
    recordings = sorted((rig / "data").glob("*.csv"))
    document = only_json(servotwin("trace", "info", *recordings, "--json"))
    assert [trace["name"] for trace in document["traces"]] == [path.stem for path in recordings]
    copy = tmp_path / "copy.mat"
    document = only_json(servotwin("trace", "convert", recordings[0], copy, "--json"))
    assert document["samples"] == 101
    one, other = (formats.read(path).trace for path in (recordings[0], copy))
    np.testing.assert_array_equal(one["angle"], other["angle"])
    document = only_json(servotwin("trace", "plot", *recordings, "--out", tmp_path / "a.html", "--json"))
    assert Path(document["report"]).read_text().count("rig_0__a") > 0


def test_a_study_tells_how_recordings_are_read(rig: Path, tmp_path: Path) -> None:
    text = (rig / "data" / "rig_0__a.csv").read_text().split("\n", 1)[1]
    (tmp_path / "bare.csv").write_text(text)
    study = write_study(tmp_path / "s.yaml", traces={"files": "*.csv", "layout": {"time": 0, "columns": {"theta": 2}}})
    document = only_json(servotwin("trace", "info", tmp_path / "bare.csv", "--layout", study, "--json"))
    assert [signal["name"] for signal in document["traces"][0]["signals"]] == ["theta"]


def test_info_prints_the_layout_that_the_other_commands_take(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes("Zeit [ms];Drehzahl [°/s]\n0;1,5\n2;2,5\n".encode("cp1252"))
    shown = servotwin("trace", "info", tmp_path / "log.csv")
    assert "its numbers have decimal commas" in shown.stdout and "first rows" in shown.stdout
    assert servotwin("info", tmp_path / "log.csv").stdout == shown.stdout
    refused = servotwin("trace", "info", tmp_path / "log.csv", "--columns", "1")
    assert refused.exit_code == 2 and "names no signal; write --columns SIGNAL=1" in refused.stderr
    (tmp_path / "layout.yaml").write_text(shown.stdout[shown.stdout.index("layout:") :], encoding="utf-8")
    copies = []
    for number, said in enumerate([["--layout", tmp_path / "layout.yaml"], ["--time", 0, "--columns", "Drehzahl=1"]]):
        copies.append(tmp_path / f"{number}.parquet")
        only_json(servotwin("trace", "convert", tmp_path / "log.csv", copies[-1], *said, "--json"))
    one, other = (formats.read(path).trace for path in copies)
    assert one.time.tolist() == other.time.tolist() == [0.0, 0.002]
    assert one["Drehzahl"].tolist() == other["Drehzahl"].tolist() == [1.5, 2.5] and one.units == {"Drehzahl": "°/s"}


def test_a_converted_trace_is_there_as_a_whole_or_not_at_all(rig: Path, tmp_path: Path) -> None:
    answer = servotwin("trace", "convert", rig / "data" / "rig_0__a.csv", tmp_path / "a.xls")
    assert answer.exit_code == 2 and "format '.xls' is not known; use" in answer.stderr
    trace = Trace(np.arange(3.0), {"a]": np.arange(3.0)})
    formats.write(trace, tmp_path / "a.parquet")
    answer = servotwin("trace", "convert", tmp_path / "a.parquet", tmp_path / "sub" / "b.xyz")
    assert answer.exit_code == 2 and {path.name for path in tmp_path.iterdir()} == {"a.parquet"}


def test_a_place_that_cannot_be_written_is_one_line(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer = servotwin("run", scenario, "--out", tmp_path / "file" / "out")
    assert answer.exit_code == 2 and "Traceback" not in answer.stderr and len(answer.stderr.splitlines()) == 1


CHATTY = '''"""Prints whenever it is asked, from Python and from the C library."""
import ctypes
from .model import Model, State, output, parameter

def derivatives(t, x, u, p):
    print("here I am")
    ctypes.CDLL(None).puts(b"and here, too")
    return {"y": p.rate}

MODEL = Model("chatty", "Chatty", (output("y", "1", "Output"), parameter("rate", "1/s", 1.0, "Rate")),
              states=(State("y"),), derivatives=derivatives, solver_step=lambda p: 0.1)
'''


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="calls the C library by its POSIX name")
def test_what_fmus_print_does_not_mix_with_the_document(tmp_path: Path) -> None:
    (tmp_path / "chatty.py").write_text(CHATTY)
    targets.build(tmp_path / "chatty.py", tmp_path / "chatty.fmu", target="python")
    scenario = write_scenario(tmp_path, components={"c": {"fmu": "chatty.fmu"}}, expect=[])
    stdout, stderr = process("run", scenario, "--out", tmp_path / "out", "--json").communicate(timeout=60)
    assert json.loads(stdout)["passed"] is True
    assert "here I am" in stderr and "and here, too" in stderr


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
    study, out = STUDIES / "calibration.yaml", tmp_path / "out"
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
