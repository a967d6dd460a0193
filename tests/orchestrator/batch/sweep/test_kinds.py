"""What can vary, and how points are chosen: each kind gives the runs that it says, in the units of the variables."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import InputError, ScenarioError
from fmus.packaging import targets
from orchestrator.batch.sweep.points.designs import seed_of
from orchestrator.batch.sweep.sweep import sweep
from orchestrator.batch.sweep.told.result import SweepResult
from orchestrator.scenario.run import run_scenario
from tests.support.sweeping import FALLING, Here, study


def swept(folder: Path, **changes: object) -> SweepResult:
    return sweep(study(folder, **changes), folder / "out", Here())  # type: ignore[arg-type]


def test_a_grid_has_all_combinations_in_the_units_of_the_variables(tmp_path: Path) -> None:
    vary = {"hand.added_mass": ["50 g", 0.1], "hand.angle_start": {"between": ["0 deg", "90 deg"], "count": 3}}
    result = swept(tmp_path, vary=vary, design={"by": "grid"})
    found = list(zip(result.column("hand.added_mass"), result.column("hand.angle_start"), strict=True))
    wanted = list(itertools.product([0.05, 0.1], [0, math.pi / 4, math.pi / 2]))
    assert np.allclose(found, wanted)


def test_a_table_gives_the_points_with_the_units_of_its_head(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("hand.added_mass [g], hand.angle_start\n50, 0.1\n70, 20 deg\n")
    result = swept(tmp_path, vary=None, design={"by": "list", "table": "points.csv"})
    assert result.column("hand.added_mass") == pytest.approx([0.05, 0.07])
    assert result.column("hand.angle_start") == pytest.approx([0.1, math.radians(20)])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hand.added_mass\n", r"points\.csv: has no points"),
        ("hand.added_mass, hand.angle_start\n1\n", r"points\.csv:2: has not 2 values"),
        ("hand.added_mass\nheavy\n", r"study\.yaml: design: hand\.added_mass: cannot be 'heavy'"),
    ],
)
def test_a_table_that_is_none_is_told_with_its_line(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(ScenarioError, match=problem):
        swept(tmp_path, vary=None, design={"by": "list", "table": "points.csv"})


def test_hypercubes_of_so_many_strata_are_added_to_and_single_ones_are_not(tmp_path: Path) -> None:
    file = study(tmp_path, design={"by": "latin-hypercube", "samples": 10, "seed": 1})
    first = sweep(file, tmp_path / "out", Here()).column("hand.angle_start")
    again = study(tmp_path, design={"by": "latin-hypercube", "samples": 20, "strata": 10, "seed": 1})
    both = sweep(again, tmp_path / "out", Here()).column("hand.angle_start")
    assert np.array_equal(both[:10], first)
    low, high = math.radians(30), math.radians(90)
    for cube in np.split(both, 2):
        assert sorted(int(10 * (angle - low) / (high - low)) for angle in cube) == list(range(10))
    other = study(tmp_path, design={"by": "latin-hypercube", "samples": 30, "seed": 1})
    with pytest.raises(InputError, match=r"design\.strata was 10 and is 30"):
        sweep(other, tmp_path / "out", Here())


def test_every_point_is_run_in_every_case_that_is_wanted(tmp_path: Path) -> None:
    cases = [{"name": "slow"}, {"name": "fast", "set": {"hand.speed_start": 3}}, {"name": "left out"}]
    scenario = FALLING | {"cases": cases}
    result = swept(tmp_path, scenario=scenario, cases=["fast", "slow"], design={"by": "sobol", "samples": 4, "seed": 1})
    rows = result.table().to_pylist()
    assert [row["case"] for row in rows] == ["fast", "slow"] * 4
    assert [row["point"] for row in rows] == [0, 0, 1, 1, 2, 2, 3, 3]
    assert all(fast["e1"] > slow["e1"] for fast, slow in zip(rows[::2], rows[1::2], strict=True))


def test_without_anything_that_varies_each_case_of_a_matrix_is_a_run(tmp_path: Path) -> None:
    scenario = FALLING | {"matrix": {"axes": {"hand.added_mass": [0.05, 0.1], "hand.angle_start": [0.1, 0.2, 0.3]}}}
    result = swept(tmp_path, scenario=scenario, vary=None, design=None)
    assert result.document["runs"] == 6 and result.table(["case"])["case"][5].as_py() == "0.1, 0.3"
    single = run_scenario(tmp_path / "falling.yaml")
    assert [case.checks[0].figure for case in single.cases] == result.column("e1").tolist()


def test_cases_with_systems_of_their_own_are_run_with_these(tmp_path: Path) -> None:
    heavy = {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5, "added_mass": 0.5, "added_length": 0.1}}}
    scenario = FALLING | {"cases": [{"name": "light"}, {"name": "heavy", "components": heavy}]}
    result = swept(tmp_path, scenario=scenario, vary={"hand.speed_start": [0, 1]}, design={"by": "grid"})
    assert result.table(["case"])["case"].to_pylist() == ["light", "heavy"] * 2
    figures = result.column("e1")
    assert len(set(figures)) == 4


def test_a_constant_stimulus_varies_in_its_unit(tmp_path: Path) -> None:
    result = swept(tmp_path, vary={"hand.torque": ["0 N.m", "10 mN.m", "20 mN.m"]}, design={"by": "grid"})
    assert result.column("hand.torque") == pytest.approx([0, 0.01, 0.02])
    driven = FALLING | {"stimuli": {"hand.torque": {"constant": "20 mN.m"}}}
    (tmp_path / "falling.yaml").write_text(json.dumps(driven))
    assert run_scenario(tmp_path / "falling.yaml").cases[0].checks[0].figure == result.column("e1")[2]


def test_recordings_vary_what_drives_an_input(tmp_path: Path) -> None:
    for number, torque in enumerate((0.0, 0.02)):
        (tmp_path / f"push{number}.csv").write_text(f"time,torque\n0,{torque}\n1,{torque}\n")
    vary = {"hand.torque": {"files": ["push0.csv", "push1.csv"], "signal": "torque"}}
    result = swept(tmp_path, vary=vary, design={"by": "grid"})
    assert result.table(["hand.torque"])["hand.torque"].to_pylist() == ["push0.csv", "push1.csv"]
    constant = sweep(
        study(tmp_path, vary={"hand.torque": [0, 0.02]}, design={"by": "grid"}), tmp_path / "constant", Here()
    )
    assert np.array_equal(result.column("e1"), constant.column("e1"))


def test_fmus_take_the_place_of_a_component(tmp_path: Path) -> None:
    for mass in (0.05, 0.2):
        targets.build("pendulum", tmp_path / f"v{mass}.fmu", parameters={"added_mass": mass, "angle_start": 0.5})
    vary = {"hand": {"files": ["v0.05.fmu", "v0.2.fmu"]}, "hand.added_length": [0.1, 0.2]}
    result = swept(tmp_path, vary=vary, design={"by": "grid"})
    found = dict(zip(zip(*(result.table([n])[n].to_pylist() for n in ("hand", "hand.added_length")), strict=True),
                     result.column("e1"), strict=True))  # fmt: skip
    for (version, length), figure in found.items():
        mass = float(version.removeprefix("v").removesuffix(".fmu"))
        values = {"hand.added_mass": mass, "hand.added_length": length}
        assert run_scenario(tmp_path / "falling.yaml", values).cases[0].checks[0].figure == figure


@pytest.mark.slow
def test_noise_has_seeds_of_its_own_at_each_point(tmp_path: Path) -> None:
    scenario = {
        "title": "noise",
        "components": {"drive": {"model": "excitation", "parameters": {"shape": "random", "amplitude": 1.0}}},
        "run": {"stop": 1, "step": 0.01},
        "expect": [{"signal": "drive.signal", "rms": {"at_most": 10}}],
    }
    vary = {"drive.amplitude": [1, 2, 3]}
    result = swept(tmp_path, scenario=scenario, vary=vary, noise=["drive"], design={"by": "grid"}, traces=None)
    seeds = result.table(["drive.seed"])["drive.seed"].to_pylist()
    assert seeds == [seed_of(0, point, 0) for point in range(3)]
    figures = result.column("e1") / result.column("drive.amplitude")
    assert len(set(figures.round(9))) == 3
    again = run_scenario(tmp_path / "falling.yaml", {"drive.amplitude": 2.0, "drive.seed": seeds[1]})
    assert again.cases[0].checks[0].figure == result.column("e1")[1]


def test_points_of_a_list_that_change_are_refused_and_those_that_are_added_are_run(tmp_path: Path) -> None:
    points = [{"hand.added_mass": mass} for mass in (0.05, 0.06, 0.07)]
    swept(tmp_path, vary=None, design={"by": "list", "points": points[:2]})
    assert swept(tmp_path, vary=None, design={"by": "list", "points": points}).document["runs"] == 3
    points[1] = {"hand.added_mass": 0.08}
    with pytest.raises(InputError, match=r"has hand\.added_mass 0\.06 at run 1, the study 0\.08; give another --out"):
        swept(tmp_path, vary=None, design={"by": "list", "points": points})


def test_a_calibrations_covariance_is_drawn_from_in_the_scenarios_units(tmp_path: Path) -> None:
    covariance = [[25.0, -6.0], [-6.0, 4.0]]  # g, cm
    (tmp_path / "calibrated").mkdir()
    summary = {
        "method": "output-error",
        "parameters": {
            "hand.added_mass": {"value": 100.0, "unit": "g"},
            "hand.added_length": {"value": 10.0, "unit": "cm"},
        },
        "uncertainty": {"covariance": {"parameters": ["hand.added_mass", "hand.added_length"], "matrix": covariance}},
    }
    (tmp_path / "calibrated" / "summary.json").write_text(json.dumps(summary))
    result = swept(
        tmp_path,
        vary=None,
        calibration={"folder": "calibrated"},
        design={"by": "monte-carlo", "samples": 400, "seed": 1},
        traces=None,
    )
    drawn = np.stack([result.column("hand.added_mass"), result.column("hand.added_length")])
    scale = np.array([1e-3, 1e-2])
    assert drawn.mean(axis=1) == pytest.approx([0.1, 0.1], abs=0.02 * 0.1 * 5)
    wanted = np.array(covariance) * np.outer(scale, scale)
    assert np.cov(drawn) / np.outer(scale, scale) == pytest.approx(np.array(covariance), abs=5)
    assert np.corrcoef(drawn)[0, 1] == pytest.approx(wanted[0, 1] / math.sqrt(wanted[0, 0] * wanted[1, 1]), abs=0.1)


@pytest.mark.parametrize(
    ("summary", "problem"),
    [
        ({"method": "resonance", "parameters": {}}, "holds no covariance, .*this is resonance"),
        ({"parameters": 3}, "holds no parameters"),
        (
            {
                "parameters": {"hand.added_mass": {"value": 1, "unit": "kg"}},
                "uncertainty": {"covariance": {"parameters": ["hand.added_mass"], "matrix": [[None]]}},
            },
            r"has not determined hand\.added_mass",
        ),
    ],
)
def test_a_calibration_that_cannot_be_drawn_from_is_told(
    tmp_path: Path, summary: dict[str, object], problem: str
) -> None:
    (tmp_path / "calibrated").mkdir()
    (tmp_path / "calibrated" / "summary.json").write_text(json.dumps(summary))
    design = {"by": "monte-carlo", "samples": 5, "seed": 1}
    with pytest.raises(ScenarioError, match=problem):
        swept(tmp_path, vary=None, calibration={"folder": "calibrated"}, design=design)


def test_a_measure_is_a_column_and_fails_nothing(tmp_path: Path) -> None:
    measures = {"dip": {"signal": "hand.angle", "peak": {"at_most": 0.001}}}
    result = swept(tmp_path, measures=measures)
    assert not result.column("dip_held").any()
    assert result.column("passed").sum() == result.column("e1_held").sum() > 0


def test_the_data_set_is_read_by_pandas(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    result = swept(tmp_path)
    frame = pandas.read_parquet(tmp_path / "out" / "runs")
    assert frame["e1"].tolist() == result.column("e1").tolist() == result.frame()["e1"].tolist()
    assert frame["hand.angle"][3].tolist() == result.table().to_pylist()[3]["hand.angle"]
