"""Values within a step, as an FMU of FMI 3.0 tells of them: kept where that is asked for, and true."""

from __future__ import annotations

import json
import logging
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuError, WiringError
from orchestrator import formats
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.engine import Result, Timing
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.run import run_scenario
from tests.support.commands import servotwin
from tests.support.fmus.between import COUNT, TROUBLES, build, levels

EVENTS = ('hasEventMode="false"', 'hasEventMode="true"')
KEPT = ("level", "input")
STEP, STEPS = Fraction(1, 10), 5


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("between"))


@pytest.fixture(scope="module")
def clocked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("clocked"), EVENTS)


def run(file: Path, kept: tuple[str, ...] = KEPT, isolated: bool = False, runs: int = 1, **values: float) -> Result:
    system = SystemSpec({"tank": ComponentSpec(file, values, intermediate=kept)})
    with OpenSystem(assemble(system, file.parent)) as opened:
        timing = Timing(STEPS * STEP, STEP)
        with opened.simulation(timing, Isolation() if isolated else None) as simulation:
            for _ in range(runs):
                result = simulation.run(system.values())
    return result


@pytest.mark.parametrize("runs", [1, 2])
def test_what_is_asked_for_is_kept_after_each_step_of_the_fmus_own(file: Path, runs: int) -> None:
    result = run(file, runs=runs, rate=2.0)
    trace = result.intermediate["tank"]
    assert trace.names == ("tank.level", "tank.input") and trace.unit("tank.level") == "m"
    assert trace.time == pytest.approx(np.arange(1, COUNT * STEPS + 1) * float(STEP) / COUNT)
    assert trace["tank.level"] == pytest.approx(levels(float(STEP), STEPS, 2.0), abs=1e-12)
    assert trace["tank.input"].tolist() == [1.0] * len(trace)
    assert trace["tank.level"][COUNT - 1 :: COUNT].tolist() == result.trace["tank.level"][1:].tolist()
    assert result.trace["tank.asked"].tolist() == [21.0] * len(result.trace)


def test_the_run_is_the_same_as_without(file: Path) -> None:
    plain = run(file, kept=())
    assert plain.intermediate == {} and plain.account.reason == ""
    kept = run(file)
    assert kept.trace["tank.level"].tolist() == plain.trace["tank.level"].tolist()
    assert kept.account.reason == "what tank gives within its steps is kept"


def test_an_fmu_with_clocks_tells_between_its_ticks(clocked: Path) -> None:
    result = run(clocked)
    trace = result.intermediate["tank"]
    assert result.trace["tank.ticks"][-1] == 2  # at 0 s and 0.25 s; that of 0.5 s belongs to the step after the end
    steps = np.diff([0.0, *trace.time])
    assert len(trace) == COUNT * (STEPS + 1) and {*steps.round(9)} == {0.025, 0.0125}
    assert trace["tank.level"] == pytest.approx(1 - np.cumprod(1 - steps), abs=1e-12)


def test_of_two_updates_at_one_time_the_last_is_kept(file: Path) -> None:
    assert run(file, trouble=TROUBLES.index("twice")).intermediate["tank"] == run(file).intermediate["tank"]


@pytest.mark.parametrize(
    ("trouble", "why"),
    [
        ("backwards", r"it speaks of t = 0\.05 s after 0\.075 s, in a step up to 0\.1 s"),
        ("beyond", r"it speaks of t = 0\.2 s after 0 s, in a step up to 0\.1 s"),
        ("no values", r"get level, input: returned error"),
    ],
)
def test_an_update_that_cannot_be_ends_the_run(file: Path, trouble: str, why: str) -> None:
    with pytest.raises(FmuError, match=r"tank: update between t = 0 s and t = 0\.1 s: " + why):
        run(file, trouble=TROUBLES.index(trouble))


def test_an_fmu_that_tells_of_nothing_is_told_of(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert len(run(file, trouble=TROUBLES.index("silent")).intermediate["tank"]) == 0
    assert "tank: told of nothing within its steps, so that nothing is kept" in caplog.text


def test_steps_that_were_not_finished_are_counted(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        run(file)
    assert f"tank: told {COUNT * STEPS} times of a step of its own that was not finished" in caplog.text


@pytest.mark.parametrize(
    ("kept", "changes", "why"),
    [
        (("rate",), [], r"'rate' is nothing that the FMU gives within a step; it gives input, level, word"),
        (("lever",), [], r"'lever' is nothing that the FMU gives"),
        (("word",), [], r"'word' is a String; choose variables that are numbers"),
        (KEPT, [("providesIntermediateUpdate", "canInterpolateInputs")], r"without intermediate upd"),
    ],
)
def test_what_the_fmu_does_not_give_is_refused(
    tmp_path: Path, kept: tuple[str, ...], changes: list[tuple[str, str]], why: str
) -> None:
    with pytest.raises(WiringError, match=r"components\.tank\.intermediate: .*" + why):
        run(build(tmp_path, *changes), kept)


def test_it_cannot_be_isolated(file: Path) -> None:
    with pytest.raises(WiringError, match=r"components\.tank\.intermediate: cannot be isolated"):
        run(file, isolated=True)


SYSTEM = """
title: A tank
components:
  tank: {fmu: between.fmu, intermediate: [level], parameters: {rate: 3}}
  gauge: {fmu: between.fmu, intermediate: [level]}
connections: [tank.level -> gauge.input, gauge.level -> tank.input]
run: {stop: 0.5, step: 0.1, ORDER}
"""


def test_steps_that_are_taken_back_leave_nothing(file: Path) -> None:
    scenario = file.with_name("iterated.yaml")
    scenario.write_text(SYSTEM.replace("ORDER", "order: iterated"))
    result = ran(scenario)
    assert result.iterations > 0
    for name in ("tank", "gauge"):
        trace = result.intermediate[name]
        assert len(trace) == COUNT * STEPS
        assert trace[f"{name}.level"][COUNT - 1 :: COUNT].tolist() == result.trace[f"{name}.level"][1:].tolist()


def ran(scenario: Path) -> Result:
    result = run_scenario(scenario).cases[0].result
    assert result is not None
    return result


@pytest.mark.parametrize("profile", [[], ["--profile"]])
def test_a_result_has_a_file_of_it(file: Path, tmp_path: Path, profile: list[str]) -> None:
    scenario = file.with_name("tank.yaml")
    scenario.write_text(SYSTEM.replace("ORDER", "order: gauss-seidel"))
    assert servotwin("run", scenario, "--out", tmp_path / "out", *profile).exit_code == 0
    (case,) = json.loads((tmp_path / "out" / "manifest.json").read_text())["cases"]
    assert case["intermediate"] == {"tank": "run.tank.parquet", "gauge": "run.gauge.parquet"}
    trace = formats.read(tmp_path / "out" / case["intermediate"]["tank"]).trace
    assert trace.names == ("tank.level",) and len(trace) == COUNT * STEPS
