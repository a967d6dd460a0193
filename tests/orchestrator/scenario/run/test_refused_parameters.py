"""Parameters of an FMU of the library that do not fit together are bad input, whatever packages it and runs it."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

from fmus import library
from fmus.errors import ParametersRefused
from fmus.modelling.symbolic import conflicts
from fmus.packaging import targets
from fmus.packaging.native import compiler
from fmus.packaging.system.fused import FusedPart, FusedSystem
from orchestrator.scenario.run import run_scenario
from tests.support.commands import servotwin
from tests.support.identification.tuning_study import study, write

FREQUENCY = (
    "frequency = 160, sample_time = 0.00333333: frequency is not below half of the sampling rate, 1 / (2 sample_time);"
    " lower one of them"
)
NOTCH = {
    "title": "A notch above half of its sampling rate",
    "components": {"filter": {"model": "notch", "parameters": {"frequency": 160}}},
    "run": {"stop": 0.1, "step": "1/300"},
    "expect": [{"signal": "filter.voltage", "below": 1}],
}


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "scenario.yaml"
    path.write_text(json.dumps(NOTCH | changes))
    return path


def refusal(path: Path, *more: str) -> str:
    """What is said of a scenario that ends with exit code 2."""
    ended = servotwin("run", path, "--out", path.parent / "out", *more)
    assert ended.exit_code == 2
    assert not (path.parent / "out").exists()
    return ended.stderr.strip()


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), [("native", 2), ("native", 3), ("python", 2)])
@pytest.mark.parametrize("more", [(), ("--isolate",)], ids=["here", "apart"])
def test_a_run_ends_with_2_and_one_line_with_component_parameters_values_and_bound(
    tmp_path: Path, target: str, fmi: int, more: tuple[str, ...]
) -> None:
    if target == "native" and not compiler.available():
        pytest.skip("no C compiler here")
    fmu = targets.build("notch", tmp_path / "notch.fmu", target=target, fmi=fmi)
    path = written(tmp_path, components={"filter": {"fmu": str(fmu), "parameters": {"frequency": 160}}})
    assert refusal(path, *more) == f"servotwin: {path}: filter: {FREQUENCY}"


def test_a_value_given_on_the_command_line_is_refused_like_one_of_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, components={"filter": {"model": "notch"}})
    assert FREQUENCY in refusal(path, "--set", "filter.frequency=160")


def test_model_exchange_is_refused_before_a_solver_begins(tmp_path: Path) -> None:
    link = {"model": "flexible_link", "parameters": {"participation_1": 1.2}, "solver": {}}
    path = written(tmp_path, components={"link": link}, expect=[{"signal": "link.angle", "below": 1}])
    line = refusal(path)
    assert line.startswith(f"servotwin: {path}: link: participation_1 = 1.2, participation_2 = ")
    assert line.endswith("the squares of the participations do not add up to less than 1; lower one")


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_system_in_one_fmu_names_its_part(tmp_path: Path, fmi: int) -> None:
    step = Fraction(1, 300)
    part = FusedPart(library.find("notch"), {"frequency": 160.0}, {}, 1, False)
    system = FusedSystem(
        "rig", "A notch", {"filter": part}, (), step, Fraction(0), Fraction(1), step, ("filter.voltage",), ()
    )
    fmu = targets.build_system(system, tmp_path / "rig.fmu", fmi=fmi)
    path = written(
        tmp_path, components={"rig": {"fmu": str(fmu)}}, expect=[{"signal": "rig.filter.voltage", "below": 1}]
    )
    assert refusal(path) == f"servotwin: {path}: rig: filter: {FREQUENCY}"


@pytest.mark.slow
def test_a_long_table_is_named_by_its_first_values(tmp_path: Path) -> None:
    payloads = [0.1 * i for i in range(9)] + [0.0]
    gains = {name: [1.0] * len(payloads) for name in ("kp", "kd", "ks")}
    controller = {"model": "gain_schedule", "parameters": {"payloads": payloads, **gains}}
    path = written(tmp_path, components={"c": controller}, expect=[{"signal": "c.voltage", "below": 1}])
    line = refusal(path)
    assert "c: payloads[1] = 0, payloads[2] = 0.1, " in line
    assert "payloads[8] = 0.7, ...: payloads do not rise from one to the next; sort the tables by them" in line


def test_a_start_that_inputs_decide_is_no_matter_of_parameters() -> None:
    energy = library.find("energy_controller")
    assert [sorted(names) for names in conflicts(energy).values()] == [["amplitude", "p3"]] * 2


def test_a_sweep_counts_such_runs_and_goes_on(tmp_path: Path) -> None:
    written(tmp_path, components={"filter": {"model": "notch"}})
    (tmp_path / "sweep.yaml").write_text(
        json.dumps({"title": "Rates", "sweep": "scenario.yaml", "vary": {"filter.frequency": [10, 160]}})
    )
    ended = servotwin("sweep", tmp_path / "sweep.yaml", "--out", tmp_path / "out", "--json")
    assert json.loads(ended.stdout)["failed"] == 1
    reasons = pyarrow.parquet.read_table(tmp_path / "out" / "runs")["reason"].to_pylist()
    assert [FREQUENCY in (reason or "") for reason in reasons] == [False, True]


def test_the_suite_tells_such_a_file_from_one_that_runs(tmp_path: Path) -> None:
    ended = servotwin("test", written(tmp_path), "--out", tmp_path / "out", "--json")
    assert ended.exit_code == 1
    assert FREQUENCY in ended.stdout


def test_what_is_raised_can_be_told_from_an_fmu_that_fails(tmp_path: Path) -> None:
    with pytest.raises(ParametersRefused) as caught:
        run_scenario(written(tmp_path))
    assert caught.value.fix == "lower one of them"


def test_a_controller_that_its_fmu_would_refuse_is_not_tuned(tmp_path: Path) -> None:
    controller = {"model": "notch", "parameters": {"frequency": 60, "sample_time": 0.01}}
    loop = ["plant.position -> controller.effort", "controller.voltage -> plant.u"]
    changes = {
        "controller": controller,
        "connections": loop,
        "reference": "controller.effort",
        "design": {"by": "given"},
    }
    ended = servotwin("tune", write(tmp_path, study(**changes)), "--out", tmp_path / "out")
    assert ended.exit_code == 2
    assert "controller: frequency = 60, sample_time = 0.01: frequency is not below half" in ended.stderr
