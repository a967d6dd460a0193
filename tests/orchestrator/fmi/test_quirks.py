"""FMUs as people meet them: resets that do nothing, ends that are asked for, values that are not finite."""

from __future__ import annotations

import json
import logging
import platform
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pythonfmu.builder import FmuBuilder
from typer.testing import CliRunner

from fmus.errors import FmuError, WiringError
from identification.cli import app
from orchestrator import formats
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Engine, RunFailed, Simulation, Timing, compiled
from orchestrator.fmi import said as fmu_said
from orchestrator.processes import arithmetic
from orchestrator.scenario.run import ScenarioFailed, run_scenario
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.fmus import quirks
from tests.support.memory_errors import memory_errors, needs_valgrind

pytestmark = pytest.mark.slow  # compilers
BOTH = (Engine.PYTHON, Engine.COMPILED) if compiled.available() else (Engine.PYTHON,)
DECAY = 0.95 ** np.arange(11)  # of x with k = 0.5 in steps of 0.1 s
SCENARIO = "title: lag\ncomponents: {lag: {fmu: quirks.fmu}}\nrun: {stop: 1, step: 0.1}\n"


def servotwin(*arguments: object, code: int = 0) -> str:
    """What the command says on stderr."""
    said = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert said.exit_code == code, said.output
    return said.stderr


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def simulated(stack: ExitStack, path: Path, **timing: Any) -> Simulation:
    """A simulation of the FMU alone, over a second."""
    slave = quirks.opened(stack, path)
    system = wire({"lag": Part(slave.interface)}, [])
    return Simulation(system, {"lag": slave}, Timing(Fraction(1), Fraction(1, 10), **timing))


def library(made: Simulation, counter: str) -> int:
    return quirks.count(made.components["lag"], counter)  # type: ignore[arg-type]


@pytest.mark.parametrize("engine", BOTH)
def test_every_run_is_terminated_at_its_end(engine: Engine, tmp_path: Path, stack: ExitStack) -> None:
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu"), engine=engine)
    for runs in (1, 2, 3):
        made.run()
        assert library(made, "terminated") == runs
    made.close()
    assert (library(made, "terminated"), library(made, "instances")) == (3, 0)


def test_isolated_fmus_are_terminated_too(tmp_path: Path) -> None:
    said = tmp_path / "said.txt"
    quirks.build(tmp_path / "quirks.fmu", ON_TERMINATE=f'FILE *f = fopen("{said}", "a"); fputs("over ", f); fclose(f);')
    (tmp_path / "lag.yaml").write_text(SCENARIO + "cases: [{name: a}, {name: b}]")
    servotwin("run", tmp_path / "lag.yaml", "--out", tmp_path / "out", "--isolate", "--json")
    assert said.read_text() == "over over "


@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize(
    ("reset", "said"),
    [
        ("", "does not bring back its start values (x is 0.598737 then)"),
        ("return fmi2Error;", "is refused (returned error)"),
    ],
)
def test_a_reset_that_does_nothing_or_is_refused_is_replaced_by_a_fresh_instance(
    reset: str, said: str, engine: Engine, tmp_path: Path, stack: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu", ON_RESET=reset), engine=engine)
    for _ in range(3):
        assert np.allclose(made.run().trace["lag.x"], DECAY)
        assert not np.allclose(made.run({"lag.k": 2.0}).trace["lag.x"], DECAY)
    assert [record.message for record in caplog.records if "reset" in record.message] == [
        f"lag: its reset {said}; every run gets a fresh instance"
    ]
    assert library(made, "instances") == 1


def test_a_reset_that_keeps_an_input_is_seen(tmp_path: Path, stack: ExitStack) -> None:
    keeping = "double u = m->number[U]; start(m); m->number[U] = u;"
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu", ON_RESET=keeping))
    made.run({"lag.u": 3.0})
    assert np.allclose(made.run().trace["lag.x"], DECAY)


@pytest.mark.parametrize("then", ["if (m->number[K] > 1)", "broken |= m->number[K] > 1; if (broken)"])
def test_after_a_fatal_error_the_fmu_is_loaded_anew(then: str, tmp_path: Path, stack: ExitStack) -> None:
    """Where one instance has spoilt the library, from a copy."""
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu", ON_STEP=f"{then} return fmi2Fatal;"))
    before = made.run().trace["lag.x"]
    for _ in range(2):
        with pytest.raises(FmuError, match="fatal"):
            made.run({"lag.k": 2.0})
        if "broken" in then:
            with pytest.raises(FmuError, match="fatal"):
                made.run()
        assert np.array_equal(made.run().trace["lag.x"], before)


@pytest.mark.parametrize("engine", BOTH)
def test_a_failed_run_keeps_what_it_gave_until_then(engine: Engine, tmp_path: Path, stack: ExitStack) -> None:
    path = quirks.build(tmp_path / "quirks.fmu", ON_STEP="if (t > 0.45) return fmi2Error;")
    made = simulated(stack, path, engine=engine)
    with pytest.raises(RunFailed) as failed:
        made.run()
    assert str(failed.value) == "lag: step from t = 0.5 s by 0.1 s: returned error"
    assert np.allclose(failed.value.result.trace["lag.x"], DECAY[:6])
    assert library(made, "terminated") == 0


@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize(("value", "word"), [("NAN", "nan"), ("-INFINITY", "-inf")])
def test_an_output_that_is_not_finite_ends_the_run_where_it_came(
    value: str, word: str, engine: Engine, tmp_path: Path, stack: ExitStack
) -> None:
    path = quirks.build(tmp_path / "quirks.fmu", ON_STEP=f"if (t > 0.45) m->number[U] = {value};")
    with pytest.raises(RunFailed) as failed:
        simulated(stack, path, engine=engine).run()
    assert str(failed.value).startswith(f"lag.x: is {word} after the step from t = 0.5 s by 0.1 s; ")
    assert np.allclose(failed.value.result.trace["lag.x"], DECAY[:6])
    allowed = simulated(stack, path, engine=engine, finite=False).run().trace["lag.x"]
    assert list(np.isfinite(allowed)) == [True] * 6 + [False] * 5


def test_the_finished_cases_and_the_failed_one_are_written(tmp_path: Path) -> None:
    quirks.build(tmp_path / "quirks.fmu", ON_STEP="if (t > 0.45 && m->number[K] > 1) return fmi2Error;")
    cases = "cases: [{name: a}, {name: b, set: {lag.k: 2}, expect: [{signal: lag.x, above: 0}]}, {name: c}]"
    (tmp_path / "lag.yaml").write_text(SCENARIO + cases)
    for streamed in ([], ["--stream"]):
        out = tmp_path / f"out{len(streamed)}"
        line = servotwin("run", tmp_path / "lag.yaml", "--out", out, "--json", *streamed, code=3)
        assert "case b: lag: step from t = 0.5 s by 0.1 s: returned error" in line
        found = json.loads((out / "manifest.json").read_text())["cases"]
        assert [case["state"] for case in found] == ["done", "failed", "not run"]
        assert not found[1]["passed"] and not found[1]["checks"][0]["held"]
        assert sorted(path.name for path in out.glob("*.parquet")) == ["a.parquet", "b.parquet"]
    with pytest.raises(ScenarioFailed) as failed:
        run_scenario(tmp_path / "lag.yaml")
    assert len(failed.value.result.cases[1].trace) == 6


def test_an_fmu_that_asks_to_stop_ends_the_run_and_is_judged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    quirks.build(tmp_path / "quirks.fmu", ASKS="1", ON_STEP="if (t > 0.45) return fmi2Discard;")
    expect = "expect: [{signal: lag.x, above: 0}, {signal: lag.x, below: 2, after: 0.7}]"
    (tmp_path / "lag.yaml").write_text(SCENARIO + expect)
    with caplog.at_level(logging.WARNING):
        servotwin("run", tmp_path / "lag.yaml", "--out", tmp_path / "out", "--json", code=1)
    (case,) = json.loads((tmp_path / "out" / "manifest.json").read_text())["cases"]
    assert case["ended"] == "lag: asked to stop at t = 0.5 s" and case["state"] == "done"
    assert [check["held"] for check in case["checks"]] == [True, False]
    assert case["stepping"]["reached"] == 0.5


def test_single_precision_inside_an_fmu_is_no_refusal_of_a_value(tmp_path: Path, stack: ExitStack) -> None:
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu", NUMBER="float"))
    made.run({"lag.k": 0.1})
    with pytest.raises(FmuError, match=r"lag\.k: was set to 1e\+300 but is inf"):
        made.run({"lag.k": 1e300})


def test_a_function_that_is_missing_matters_only_when_it_is_called(tmp_path: Path, stack: ExitStack) -> None:
    slave = quirks.opened(stack, quirks.build(tmp_path / "quirks.fmu"))
    with pytest.raises(FmuError, match="lag: its library has no function fmi2GetFMUstate"):
        slave.save()


def scenario(folder: Path, text: str = "", run: str = "", **quirk: Any) -> Path:
    """A scenario of the FMU over a second."""
    quirks.build(folder / "quirks.fmu", **quirk)
    path = folder / "lag.yaml"
    path.write_text(SCENARIO.replace("step: 0.1", f"step: 0.1{run}") + text)
    return path


def test_any_variable_that_is_a_number_is_recorded_and_judged(tmp_path: Path) -> None:
    text = "record: [lag.k, lag.on, lag.u, lag.x]\nexpect: [{signal: lag.x, near: 1, within: 1}]"
    (case,) = run_scenario(scenario(tmp_path, text, output=False)).cases
    assert case.passed and np.allclose(case.trace["lag.x"], DECAY)
    assert [case.trace[name][-1] for name in ("lag.k", "lag.on", "lag.u")] == [0.5, 0, 0]


def test_an_fmu_without_outputs_runs_and_leaves_a_report(tmp_path: Path) -> None:
    said = servotwin("run", scenario(tmp_path, output=False), "--out", tmp_path / "out", "-v")
    assert "nothing is recorded" in said and (tmp_path / "out" / "report.html").is_file()


def test_text_is_said_not_to_be_recorded(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run_scenario(scenario(tmp_path))
    assert "texts are recorded where `record` names them, not by themselves: lag.said" in caplog.text


def test_a_boolean_input_holds_each_sample_until_the_next(tmp_path: Path) -> None:
    (tmp_path / "on.csv").write_text("time [s],on,u\n0,0,0\n0.55,1,1\n1,0,2\n")
    text = (
        "record: [lag.on, lag.u]\nstimuli:\n  lag.on: {file: on.csv, signal: on}\n  lag.u: {file: on.csv, signal: u}\n"
    )
    trace = run_scenario(scenario(tmp_path, text)).cases[0].trace
    assert list(trace["lag.on"]) == [0] * 6 + [1] * 4 + [0]
    assert np.allclose(trace["lag.u"], np.interp(trace.time, [0, 0.55, 1], [0, 1, 2]))
    with pytest.raises(WiringError, match=r"lag\.on: is discrete and has no values between samples; leave out"):
        run_scenario(scenario(tmp_path, text.replace("signal: on}", "signal: on, interpolation: linear}")))


def test_end_and_tolerance_are_told_where_they_are_asked_for(tmp_path: Path) -> None:
    told = tmp_path / "told.txt"
    say = 'fprintf(f, "%d %g %d %g;", hasStop, stop, hasTolerance, tolerance)'
    setup = f'FILE *f = fopen("{told}", "a"); {say}; fclose(f);'
    run_scenario(scenario(tmp_path, ON_SETUP=setup))
    run_scenario(scenario(tmp_path, run=", tell_stop: true, tolerance: 1.0e-6", ON_SETUP=setup))
    assert told.read_text() == "0 0 0 0;1 1 1 1e-06;"


LAG_STUDY = """title: lag
method: output-error
components: {lag: {fmu: quirks.fmu}}
step: 0.1
tolerance: 1.0e-6
tell_stop: true
traces: {files: log.csv}
outputs: {lag.x: {signal: x}}
windows: {length: 1}
parameters: {lag.k: {start: 0.5, min: 0.1, max: 1}}
"""


def lag_study(folder: Path) -> Path:
    """A study of the lag and its recording, both in the folder of `quirks.fmu`."""
    time = np.arange(11) / 10
    formats.write(Trace(time, {"x": 0.96 ** np.arange(11)}), folder / "log.csv")
    (folder / "study.yaml").write_text(LAG_STUDY)
    return folder / "study.yaml"


def test_free_runs_tell_their_end_and_a_tolerance_where_a_study_asks_for_it(tmp_path: Path) -> None:
    told = tmp_path / "told.txt"
    say = 'fprintf(f, "%d %g %d %g;", hasStop, stop, hasTolerance, tolerance)'
    quirks.build(tmp_path / "quirks.fmu", ON_SETUP=f'FILE *f = fopen("{told}", "a"); {say}; fclose(f);')
    servotwin("calibrate", lag_study(tmp_path), "--data", tmp_path, "--out", tmp_path / "out")
    assert set(told.read_text().split(";")) == {"1 1 1 1e-06", ""}


@pytest.mark.parametrize("options", [[], ["--isolate"]])
def test_what_fmus_say_in_a_calibration_and_a_validation_is_kept_counted_and_told(
    options: list[str], tmp_path: Path
) -> None:
    quirks.build(tmp_path / "quirks.fmu", ON_STEP='say(m, "torque clipped");')
    study, result = lag_study(tmp_path), tmp_path / "out"
    for command in (["calibrate", study], ["validate", result]):
        folder = result if command[0] == "calibrate" else result / "validation"
        arguments = [*command, "--data", tmp_path, "--out", folder, *options]
        done = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert done.exit_code == 0, done.output
        summary = json.loads((folder / "summary.json").read_text())
        lines = (folder / "fmu.log").read_text().splitlines()
        assert set(lines) == {f"WARNING lag: torque clipped at {round(k / 10, 1):g}" for k in range(10)}
        assert summary["messages"] == {"file": "fmu.log", "count": len(lines)} and len(lines) % 10 == 0
        assert f"lag: torque clipped at 0 (one of {len(lines):,} like this); all in fmu.log" in summary["warnings"]
        assert f"one of {len(lines):,} like this" in " ".join(done.stdout.split())
        assert "torque clipped" in (folder / "report.html").read_text()


def test_a_file_of_messages_does_not_grow_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_said, "LARGEST", 1000)
    with fmu_said.kept(tmp_path / "fmu.log"):
        for number in range(100):
            fmu_said.LOG.warning("talker: torque clipped at %s", number)
    *most, last = (tmp_path / "fmu.log").read_text().splitlines()
    assert 1000 <= len("\n".join(most)) < 1050 and "the file is full" in last
    first, _ = fmu_said.counted(tmp_path / "fmu.log")
    assert (first.text, first.count) == ("talker: torque clipped at 0", len(most))


def test_an_fmu_that_discards_its_initialisation_fails_without_terminate_and_starts_from_other_values(
    tmp_path: Path, stack: ExitStack
) -> None:
    """FMI 3.0, 2.2.3 and 2.3: it has failed for want of another way on; it was never initialised, but can be reset."""
    made = simulated(
        stack, quirks.build(tmp_path / "quirks.fmu", ON_INITIALISED="if (m->number[K] < 0) return fmi2Discard;")
    )
    for runs in (1, 2):
        with pytest.raises(FmuError, match=r"lag: initialise: returned discard: there is no start from these values"):
            made.run({"lag.k": -1.0})
        assert library(made, "terminated") == runs - 1
        np.testing.assert_allclose(made.run().trace["lag.x"], DECAY)


def test_what_is_not_finite_is_allowed_where_it_is_meant_and_counted(tmp_path: Path) -> None:
    path = scenario(tmp_path, run=", nonfinite: allow", ON_STEP="if (t > 0.45) m->number[U] = NAN;")
    said = servotwin("run", path, "--out", tmp_path / "out")
    assert "5 samples of lag.x are not finite" in " ".join(said.split())
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["cases"][0]["nonfinite"] == {"lag.x": 5}


@pytest.mark.parametrize("options", [[], ["--isolate"]])
def test_like_messages_are_shown_a_few_times_and_all_are_kept(options: list[str], tmp_path: Path) -> None:
    path = scenario(tmp_path, ON_STEP='for (int i = 0; i < 100; i++) say(m, "torque clipped");')
    said = servotwin("run", path, "--out", tmp_path / "out", *options)
    assert said.count("torque clipped") == 4 and "997 more like this" in said
    kept = (tmp_path / "out" / "fmu.log").read_text().splitlines()
    assert len(kept) == 1000 and kept[999] == "WARNING lag: torque clipped at 0.9"
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["log"] == "fmu.log"


def test_a_record_that_memory_cannot_hold_is_refused_before_it_begins(tmp_path: Path) -> None:
    path = scenario(tmp_path)
    path.write_text(path.read_text().replace("stop: 1,", "stop: 1.0e+12,"))
    line = servotwin("run", path, "--out", tmp_path / "out", code=2)
    assert "10,000,000,000,001 rows of 1 values to keep would take 80,000 GB of memory, " in line and "--stream" in line


UPWARD = "fesetround(FE_UPWARD);"
TO_ZERO = "__builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);"  # as GCC's -ffast-math does where it is loaded


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the instructions are those of x86-64")
@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize(
    ("quirk", "code", "told"),
    [
        ("ON_SETUP", UPWARD, "does not round to the nearest number since the FMU was called; this is undone"),
        ("ON_SETUP", TO_ZERO, "takes numbers below 2.2e-308 for zero since the FMU was called; this is undone"),
        ("ON_STEP", UPWARD, "does not round to the nearest number, by this FMU or one beside it: what was computed"),
        ("ON_STEP", TO_ZERO, "takes numbers below 2.2e-308 for zero, by this FMU or one beside it: what was computed"),
    ],
)
def test_arithmetic_that_an_fmu_changes_for_all_is_told_and_set_back(
    quirk: str,
    code: str,
    told: str,
    engine: Engine,
    tmp_path: Path,
    stack: ExitStack,
    caplog: pytest.LogCaptureFixture,
) -> None:
    stack.callback(arithmetic.set_back)
    made = simulated(stack, quirks.build(tmp_path / "quirks.fmu", **{quirk: code}), engine=engine)
    result = made.run()
    (said,) = [message for message in caplog.messages if "the processor" in message]
    assert said.startswith(f"lag: the processor {told}")
    assert not arithmetic.altered()
    if quirk == "ON_SETUP":
        assert result.trace["lag.x"] == pytest.approx(DECAY, rel=1e-15)


@needs_valgrind
def test_a_process_that_ran_anothers_python_fmu_ends_without_touching_freed_memory(tmp_path: Path) -> None:
    """pythonfmu 0.7 writes there at the end of a process unless it has let go of Python before: some abort."""
    source = tmp_path / "constant.py"
    source.write_text(
        "from pythonfmu import Fmi2Causality, Fmi2Slave, Real\n"
        "class Constant(Fmi2Slave):\n"
        "    def __init__(self, **kwargs):\n"
        "        super().__init__(**kwargs)\n"
        "        self.y = 1.0\n"
        "        self.register_variable(Real('y', causality=Fmi2Causality.output))\n"
        "    def do_step(self, current_time, step_size):\n"
        "        return True\n"
    )
    FmuBuilder.build_FMU(source, tmp_path)
    program = (
        "from fmpy import extract, read_model_description as read\n"
        "from orchestrator.fmi.functions.library import FMU2Slave\n"
        f"path = {str(tmp_path / 'Constant.fmu')!r}; told, folder = read(path), extract(path)\n"
        "fmu = FMU2Slave(guid=told.guid, unzipDirectory=folder, instanceName='a', modelIdentifier='Constant')\n"
        "fmu.instantiate(); fmu.setupExperiment(startTime=0.0); fmu.enterInitializationMode()\n"
        "fmu.exitInitializationMode(); fmu.doStep(0.0, 0.1)\n"
        "assert fmu.getReal([variable.valueReference for variable in told.modelVariables]) == [1.0]\n"
        "fmu.freeInstance()\n"
    )
    assert "finalizePythonInterpreter" not in memory_errors(program, tmp_path)
