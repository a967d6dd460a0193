"""FMUs as people meet them: resets that do nothing, ends that are asked for, values that are not finite."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fmus.errors import FmuError
from identification.cli import app
from orchestrator.engine import Engine, RunFailed, Simulation, Timing, compiled
from orchestrator.scenario.run import ScenarioFailed, run_scenario
from orchestrator.system import Part, wire
from tests.support import quirks

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
