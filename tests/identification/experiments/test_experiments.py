"""Campaigns of experiments: what they find on rigs that are known, and which of the thesis' claims hold on its rig."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.signal import cont2discrete

from fmus.errors import IdentificationError, ScenarioError
from identification.calibrate import calibrate_study
from identification.experiments.claims import Inequality, figures, judge
from identification.experiments.experiments import Experiments, run
from identification.experiments.physical_modes import PhysicalMode, physical_modes
from identification.experiments.schema import ExperimentsBlock, InequalityBlock
from identification.experiments.set_result import distances, mean
from identification.experiments.tables import runs, tables
from identification.linear.model import LinearModel
from identification.linear.modes import Mode, from_modes
from identification.validation import validate_result
from orchestrator.progress import silent
from orchestrator.yaml_file import load
from tests.support.commands import servotwin

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

SCENARIOS = Path(__file__).parents[3] / "scenarios" / "flexible_arm"
STEP, SAMPLES = 0.01, 2000
OUTPUTS = ["position", "strain", "speed"]


# A rig that is linear but for dry friction, which its controller compensates exactly.


def plant() -> LinearModel:
    """A hub on a weak spring and a mode of 3 Hz."""
    omega = 2 * math.pi * 3
    a = np.array([[0, 1, 0, 0], [-0.2, -1.5, 0, 0], [0, 0, 0, 1], [0, 0, -(omega**2), -0.06 * omega]])
    b = np.array([[0.0], [2.0], [0.0], [30.0]])
    c = np.array([[1, 0, 0.01, 0], [0, 0, 1, 0], [0, 1, 0, 0.01]])
    ad, bd, cd, dd, _ = cont2discrete((a, b, c, np.zeros((3, 1))), STEP)
    return LinearModel(ad, bd, cd, dd, STEP, ("u",), tuple(OUTPUTS))


def recording(reference: np.ndarray, kp: float, kd: float, compensation: float) -> dict[str, np.ndarray]:
    """The loop u = kp (r - position) - kd speed, or u = r for kp = 0; the compensation is on top of the recorded u."""
    model, x = plant(), np.zeros(4)
    u, y = np.zeros(SAMPLES), np.zeros((SAMPLES, 3))
    for k in range(SAMPLES):
        y[k] = model.c @ x
        u[k] = kp * (reference[k] - y[k, 0]) - kd * y[k, 2] if kp else reference[k]
        x = model.a @ x + model.b[:, 0] * u[k]
    noise = 1e-5 * np.random.default_rng(1).standard_normal(y.shape)
    signals = dict(zip(OUTPUTS, (y + noise).T, strict=True))
    return {"u": u + compensation * np.sign(u), "reference": reference, **signals}


def write(file: Path, signals: dict[str, np.ndarray]) -> None:
    table = np.column_stack([STEP * np.arange(SAMPLES), *signals.values()])
    np.savetxt(file, table, delimiter=",", header=",".join(["time", *signals]), comments="", fmt="%.17g")


def study_of(**changes: Any) -> dict[str, Any]:
    """A study of two data sets, O_dat1 and C_dat1."""
    common = {"volts": 1, "rate": 100, "samples": SAMPLES}
    return {
        "title": "A linear rig",
        "method": "experiments",
        "scenarios": ["none.yaml"],
        "input": "u",
        "outputs": OUTPUTS,
        "preparation": {"zero_mean": ["strain"], "cutoff": None},
        "compare": {"name": "filtered", "zero_mean": ["strain"], "cutoff": 20},
        "block": 12,
        "orders": [2, 8],
        "compared": 4,
        "feedback": {
            "proportional": 1,
            "derivative": 0.5,
            "position": "position",
            "speed": "speed",
            "reference": "reference",
            "records": {0: "C_dat1"},
        },
        "physical": {
            "model": "flexible_arm",
            "payload": "payload",
            "without": {"bristle_stiffness": 1e-6, "bristle_damping": 0},
        },
        "sets": {
            "O_dat1": {**common, "experiment": "open loop", "excitation": "random"},
            "C_dat1": {**common, "experiment": "closed loop", "excitation": "square", "compensation": 0.4},
        },
        "frequencies": {"O_dat1": [3.0]},
        "typical": ["O_dat1"],
        "examples": [{"name": "Ac1", "data": "C_dat1", "table": "3-1", "order": 3}],
        "claims": [
            {
                "statement": "without is better",
                "outcome": "held",
                "holds": [{"less": ["C_dat1.sfv"], "than": ["C_dat1c.sfv"], "times": 5}],
            },
            {
                "statement": "the opposite",
                "outcome": "not borne out",
                "reason": "because",
                "holds": [{"less": ["C_dat1c.sfv"], "than": ["C_dat1.sfv"]}],
            },
        ],
        **changes,
    }


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the data sets of the linear rig in `data`, and the study."""
    folder = tmp_path_factory.mktemp("linear")
    (folder / "data").mkdir()
    rng = np.random.default_rng(3)
    write(folder / "data" / "O_dat1.csv", recording(np.repeat(rng.standard_normal(SAMPLES // 5), 5), 0, 0, 0.0))
    square = np.sign(np.sin(2 * np.pi * 0.21 * STEP * np.arange(SAMPLES) + 0.3))
    write(folder / "data" / "C_dat1.csv", recording(square, 1, 0.5, 0.4))
    (folder / "study.yaml").write_text(json.dumps(study_of()))
    return folder


@pytest.fixture(scope="module")
def found(linear: Path) -> Experiments:
    return run(load(linear / "study.yaml", ExperimentsBlock), linear, linear / "data", silent)


@pytest.fixture(scope="module")
def result(linear: Path) -> Path:
    """The folder that the command leaves."""
    calibrate_study(linear / "study.yaml", linear / "data", linear / "out", silent)
    return linear / "out"


def test_models_of_a_linear_rig_match_the_data_and_follow_the_set_point(found: Experiments) -> None:
    for code in ("O_dat1", "C_dat1"):
        errors = found.results[code].attempts[2].errors
        assert mean(errors.dmv) < 0.02
        assert mean(errors.sfv) < 0.02


def test_leaving_the_compensation_in_the_input_spoils_a_model(found: Experiments) -> None:
    best = {label: mean(found.results[label].chosen.errors.sfv) for label in ("C_dat1", "C_dat1c")}
    assert best["C_dat1c"] > 10 * best["C_dat1"]


def test_claims_are_judged_and_only_those_not_borne_out_are_explained(found: Experiments) -> None:
    held, failed = judge(found)
    assert (held.outcome, held.reason) == ("held", "")
    assert (failed.outcome, failed.reason) == ("not borne out", "because")


def test_a_claim_that_comes_out_otherwise_than_stated_fails_the_command(linear: Path, tmp_path: Path) -> None:
    study = study_of()
    study["claims"][1]["outcome"] = "held in part"
    (linear / "otherwise.yaml").write_text(json.dumps(study))
    places = [str(linear / "otherwise.yaml"), "--data", str(linear / "data"), "--out", str(tmp_path / "out")]
    answer = servotwin("calibrate", *places, "--json")
    document = json.loads(answer.stdout)
    assert answer.exit_code == 1
    assert "'the opposite' is not borne out, where the study states 'held in part'" in document["warnings"]


def test_claims_are_tried_under_the_other_preparation_too(result: Path) -> None:
    document = json.loads((result / "summary.json").read_text())
    own, other = document["figures"], document["compared"]
    assert [claim["compared"]["outcome"] for claim in document["claims"]] == ["held", "not borne out"]
    assert other["O_dat1.dmv"] != own["O_dat1.dmv"]
    assert other["O_dat1.dmv"] < 0.05


def test_a_claim_about_an_unknown_figure_is_refused(found: Experiments) -> None:
    claim = {"statement": "?", "outcome": "held", "holds": [{"less": ["O_dat9.dmv"], "than": [1.0]}]}
    study = ExperimentsBlock.model_validate(study_of(claims=[claim]))
    with pytest.raises(ScenarioError, match=r"claims\[0\].*no figure 'O_dat9.dmv'"):
        judge(replace(found, study=study))


def test_an_unstable_loop_is_worse_than_any_number() -> None:
    block = InequalityBlock(less=[1e6], than=["B_dat9.sfv"])
    assert Inequality(block, 1e6, math.inf).held
    assert not Inequality(block, math.inf, math.inf).held


def test_every_table_of_both_chapters_is_there(found: Experiments) -> None:
    numbers = [table.number for table in tables(found)]
    assert numbers == ["2-1", "2-2", "2-3", "2-4", "2-5", "2-6", "3-1a", "3-1b", "3-6"]
    assert all(len(row) == len(table.headers) for table in tables(found) for row in table.rows)


def test_orders_are_written_as_in_the_thesis() -> None:
    assert runs([8, 11, 12, 14, 33, 34, 35, 36]) == "8, 11, 12, 14, 33-36"
    assert runs([]) == "no stable model"


def test_the_result_folder_holds_models_in_the_signals_own_units(result: Path) -> None:
    document = json.loads((result / "summary.json").read_text())
    order = document["sets"]["O_dat1"]["order"]
    matrices = document["linear_models"][f"Ao1_{order}"]["matrices"]
    omega = 2 * np.pi * np.array([0.3, 1.0, 3.0])
    a, b, c, d = (np.array(matrices[name]) for name in "abcd")
    model = LinearModel(a, b, c, d, STEP, ("u",), tuple(OUTPUTS))
    truth = plant().frequency_response(omega)
    np.testing.assert_allclose(model.frequency_response(omega), truth, atol=0.02 * np.abs(truth).max())
    assert "Table 3-1b" in (result / "report.html").read_text()


def test_a_result_cannot_be_validated_on_other_traces(linear: Path, result: Path, tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match="is no study of FMUs or of a linear model on recordings"):
        validate_result(result, linear / "data", tmp_path / "validation", silent)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"typical": ["O_dat7"]}, "no data set 'O_dat7'"),
        ({"orders": [9, 8]}, "least, most"),
        ({"examples": [{"name": "O_dat1", "data": "O_dat1"}]}, "names of their own"),
    ],
)
def test_a_study_that_does_not_fit_itself_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    (tmp_path / "study.yaml").write_text(json.dumps(study_of(**changes)))
    with pytest.raises(ScenarioError, match=message):
        load(tmp_path / "study.yaml", ExperimentsBlock)


def test_a_data_set_without_a_record_is_refused(linear: Path, tmp_path: Path) -> None:
    (tmp_path / "O_dat1.csv").write_bytes((linear / "data" / "O_dat1.csv").read_bytes())
    with pytest.raises(ScenarioError, match=r"sets\.C_dat1"):
        run(load(linear / "study.yaml", ExperimentsBlock), linear, tmp_path, silent)


def test_a_record_at_another_rate_than_the_study_says_is_refused(linear: Path, tmp_path: Path) -> None:
    document = study_of()
    document["sets"]["O_dat1"]["rate"] = 50
    (tmp_path / "study.yaml").write_text(json.dumps(document))
    with pytest.raises(IdentificationError, match=r"sets\.O_dat1.*2000 samples at 100 Hz"):
        run(load(tmp_path / "study.yaml", ExperimentsBlock), tmp_path, linear / "data", silent)


def test_frequencies_count_only_where_they_come_back_at_the_next_order() -> None:
    like = plant()

    def mode(frequency: float) -> Mode:
        pole = 2 * math.pi * frequency * complex(-0.03, math.sqrt(1 - 0.03**2))
        return Mode(complex(np.exp(pole * STEP)), STEP, np.array([1 + 1j]), np.array([1 + 0j, 2, 3]))

    models = [from_modes([mode(10.2), *map(mode, others)], like) for others in ((), (9.6,), (9.1, 10.9))]
    away = distances(models, [PhysicalMode(10.0, 0.03), PhysicalMode(30.0, 0.03)])
    assert away == pytest.approx((0.02, math.inf))


# The arm.

SLIDING = {"bristle_stiffness": 1e-6, "bristle_damping": 0.0, "tip_fixture": 0.0}


@pytest.mark.parametrize(("hub", "roots"), [(1e6, (1.8751, 4.6941, 7.8548)), (1e-7, (3.9266, 7.0686))])
def test_physical_modes_are_those_of_a_beam_with_its_end_clamped_or_pinned(
    hub: float, roots: tuple[float, ...]
) -> None:
    found = physical_modes("flexible_arm", {**SLIDING, "hub_inertia": hub})
    expected = [root**2 / (2 * math.pi) * math.sqrt(7.906 / 0.4131) for root in roots]
    assert [mode.frequency for mode in found[: len(roots)]] == pytest.approx(expected, rel=0.01)


def part(folder: Path, **cases: list[str]) -> None:
    """Scenarios of these names with these cases only, and the parts that they include."""
    shutil.copytree(SCENARIOS / "parts", folder / "parts")
    for name, kept in cases.items():
        document = YAML(typ="safe", pure=True).load((SCENARIOS / f"{name}.yaml").read_text())
        document["cases"] = [case for case in document["cases"] if case["name"] in kept]
        (folder / f"{name}.yaml").write_text(json.dumps(document))


def test_reduction_by_mrm_and_updating_keep_what_reduction_by_msv_loses_on_the_arm(tmp_path: Path) -> None:
    part(tmp_path, closed_loop=["C_dat2"])
    document = YAML(typ="safe", pure=True).load((SCENARIOS / "chapters.yaml").read_text())
    document |= {
        "scenarios": ["closed_loop.yaml"],
        "typical": [],
        "frequencies": {},
        "claims": [],
        "sets": {"C_dat2": document["sets"]["C_dat2"]},
        "orders": [34, 36],
        "compare": None,
    }
    document["feedback"]["records"] = {0: "C_dat2"}
    document["examples"] = [example for example in document["examples"] if example["data"] == "C_dat2"]
    (tmp_path / "study.yaml").write_text(json.dumps(document))
    found = run(load(tmp_path / "study.yaml", ExperimentsBlock), tmp_path, None, silent)
    error = {stage.name: mean(stage.errors.dmv) for stage in found.reductions["Ac2"].stages}
    assert mean(found.results["C_dat2"].chosen.errors.sfv) < 0.8 * mean(found.results["C_dat2c"].chosen.errors.sfv)
    assert error["initial"] < 0.25
    assert error["msv"] > 1.5 * error["mrm"]
    assert error["updated"] < 1.2 * error["initial"]
    assert error["further"] < 1.1 * error["updated"]


@pytest.mark.slow
@pytest.mark.shipped
def test_the_claims_of_the_thesis_come_out_on_the_arm_as_the_study_states(tmp_path: Path) -> None:
    found = run(load(SCENARIOS / "chapters.yaml", ExperimentsBlock), SCENARIOS, None, silent)
    assert [judged.claim.statement for judged in judge(found) if not judged.as_stated] == []
    known = figures(found)  # margins that five draws of the noise leave
    closed_loop = [known[f"C_dat{number}.sfv"] for number in (1, 2, 3, 4)]
    assert 1.7 * max(closed_loop) < min(known[f"O_dat{number}.sfv"] for number in (2, 6, 10, 13))
    assert all(known[f"C_dat{number}c.sfv"] > 1.7 * known[f"C_dat{number}.sfv"] for number in (1, 2, 3, 4))
    assert all(known[f"{name}.msv.dmv"] > 1.3 * known[f"{name}.mrm.dmv"] for name in ("Ac2", "Ac3"))
    assert all(known[f"{name}.updated.dmv"] < 1.15 * known[f"{name}.initial.dmv"] for name in ("Ac2", "Ac3", "Ac11"))
