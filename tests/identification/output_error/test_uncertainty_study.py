"""Intervals of a study: what its key asks for, and what of it is in the summary and the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import IdentificationError, InputError, ScenarioError
from identification.calibrate import calibrate_study
from identification.output_error.schema import OutputErrorBlock
from identification.study import load_study
from tests.support.identification.small_study import TRUTH, study, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

Document = dict[str, Any]


def calibrated(tmp_path: Path, data: Path, **changes: Any) -> tuple[Document, str]:
    """Summary and report of the small study with these changes."""
    told = calibrate_study(write_study(tmp_path / "s.yaml", **changes), data, tmp_path / "out", lambda *_: None)
    assert told["parameters"]
    text = (tmp_path / "out" / "summary.json").read_text()
    assert "Infinity" not in text and "NaN" not in text
    return json.loads(text), (tmp_path / "out" / "report.html").read_text()


def test_profiles_are_kept_and_drawn(tmp_path: Path, data: Path) -> None:
    summary, page = calibrated(tmp_path, data, uncertainty="profile")
    assert summary["uncertainty"]["intervals"] == "profile"
    for name, truth in TRUTH.items():
        curve, (low, high) = summary["uncertainty"]["profiles"][name], summary["parameters"][name]["ci95"]
        assert low <= truth <= high
        assert curve["values"] == sorted(curve["values"]) and len(curve["values"]) >= 5
        assert min(curve["rise"]) == 0 and max(curve["rise"]) >= 0.9 * curve["threshold"]
        assert curve["local95"] == pytest.approx([low, high], rel=0.01), "short intervals are local ones"
    assert "Profiles: how the least cost rises" in page and "locally from" in page


def test_what_is_taken_for_noise_is_told_by_output(tmp_path: Path, data: Path) -> None:
    summary, page = calibrated(tmp_path, data)
    noise = summary["uncertainty"]["noise"]["hand.angle"]
    assert noise["std"] == pytest.approx(2e-4, rel=0.1) and noise["white"]
    assert noise["samples_each"] == 1 and noise["resolution"] == 0
    assert "What is taken for noise" in page
    assert "take the model, and whatever is fixed in it, for right" in page
    assert summary["uncertainty"]["given"].endswith("a wrong constant that other parameters make up for shows nowhere")


def test_a_constant_that_is_wrong_is_never_passed_over(tmp_path: Path, data: Path) -> None:
    """The added masses sit at 0.1 m; told 0.08 m, truths lie outside of intervals that are said to be of the fit."""
    components = study()["components"]
    components["hand"]["parameters"]["added_length"] = 0.08
    summary, _ = calibrated(tmp_path, data, components=components)
    off = {name: summary["parameters"][name]["ci95"] for name in TRUTH}
    assert any(not low <= TRUTH[name] <= high for name, (low, high) in off.items())
    said = next(warning for warning in summary["warnings"] if warning.startswith("residuals are not white"))
    assert "not how near it is to the truth" in said and "hand.angle (" in said


def test_what_would_tell_parameters_apart_is_named(tmp_path: Path, data: Path) -> None:
    """Without the known masses, only ratios are seen."""
    traces = {"files": "rig_0__a.csv", "hold_out": []}
    summary, page = calibrated(tmp_path, data, traces=traces)
    (unseen,) = summary["uncertainty"]["unseen"]
    assert "only their ratios are seen" in unseen and unseen in summary["warnings"]
    remedy = "something of known size: an added mass, or a sensor of the force or the current"
    assert any(warning.startswith("what would show") and remedy in warning for warning in summary["warnings"])
    assert remedy in page


def test_the_report_shows_which_part_informs_which_parameter(tmp_path: Path, data: Path) -> None:
    _, page = calibrated(tmp_path, data)
    assert "Which part of the windows informs which parameter" in page
    assert "Share of each trace and output" in page


def parameters(**prior: Any) -> Document:
    """Those of the small study, with a prior of the inertia."""
    known: Document = study()["parameters"]
    known["hand.inertia"] = {**known["hand.inertia"], "prior": prior}
    return known


def test_what_is_known_before_stands_beside_the_estimate(tmp_path: Path, data: Path) -> None:
    prior = {"mean": "40.1 kg.cm2", "std": "0.02 kg.cm2", "source": "data sheet, page 3"}
    summary, page = calibrated(tmp_path, data, parameters=parameters(**prior))
    known = summary["parameters"]["hand.inertia"]["prior"]
    assert known["text"] == "0.00401 ± 2e-06" and known["source"] == "data sheet, page 3"
    assert 0 < known["added"] < 1
    assert 0.004 < summary["parameters"]["hand.inertia"]["value"] < 0.00401
    assert "What was known before" in page and "data sheet, page 3" in page


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ({"mean": 0.5, "std": 0.1}, r"parameters\.hand\.inertia\.prior: mean 0.5 is outside the parameter's bounds"),
        ({"mean": "5 rad", "std": 0.1}, "hand.inertia"),
    ],
)
def test_a_prior_that_makes_no_sense_is_refused(tmp_path: Path, data: Path, prior: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        calibrated(tmp_path, data, parameters=parameters(**prior))
    assert "s.yaml" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"prior": {"mean": 1.0}}, "give `mean` and `std`, `median` and `factor`, or `min` and `max`"),
        ({"prior": {"mean": 0.004, "std": 1e-4}, "fixed": True}, "a prior is of a free parameter"),
    ],
)
def test_a_prior_of_no_kind_is_refused_with_its_line(tmp_path: Path, change: Document, message: str) -> None:
    known = study()["parameters"]
    known["hand.inertia"] |= change
    with pytest.raises(ScenarioError, match=message) as caught:
        load_study(write_study(tmp_path / "s.yaml", parameters=known))
    assert "parameters.hand.inertia" in str(caught.value)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("exact", "input should be 'local', 'profile' or 'bootstrap'"),
        ("bootstrap", r"a bootstrap draws windows and needs a `seed`: \{by: bootstrap, seed: 1\}"),
        ({"by": "profile", "seed": 1}, "`seed` is of `by: bootstrap`; remove it"),
        ({"by": "bootstrap", "seed": 1, "resamples": 3}, "greater than or equal to 100"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_place(tmp_path: Path, given: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message) as caught:
        load_study(write_study(tmp_path / "s.yaml", uncertainty=given))
    assert "uncertainty" in str(caught.value)


def test_a_bootstrap_of_two_windows_is_refused(tmp_path: Path, data: Path) -> None:
    with pytest.raises(IdentificationError, match="uncertainty: 2 windows are too few to be drawn from"):
        calibrated(tmp_path, data, uncertainty={"by": "bootstrap", "seed": 1})


@pytest.mark.slow
def test_a_bootstrap_says_what_it_drew(tmp_path: Path, data: Path) -> None:
    changes: Document = {"windows": {"length": 0.4, "every": 0.1}, "uncertainty": {"by": "bootstrap", "seed": 3}}
    changes["initial"] = {
        "hand.angle_start": {"signal": "angle", "half_width": 0.05, "estimated": True},
        "hand.speed_start": {"signal": "angle", "derivative": 1, "half_width": 0.05, "estimated": True},
    }
    summary, _ = calibrated(tmp_path, data, **changes)
    drawn = summary["uncertainty"]["bootstrap"]
    assert (drawn["resamples"], drawn["seed"], drawn["kind"]) == (200, 3, "bca")
    assert summary["uncertainty"]["intervals"] == "bootstrap"
    assert any("a bootstrap draws them as independent ones" in warning for warning in summary["warnings"])


def test_intervals_of_windows_that_overlap_are_told_to_allow_for_that(tmp_path: Path, data: Path) -> None:
    summary, _ = calibrated(tmp_path, data, windows={"length": 0.4, "every": 0.1})
    assert any("a sample is in 2.8 of them on average: intervals are 1.7" in warning for warning in summary["warnings"])


def test_every_key_of_an_output_error_study_is_explained() -> None:
    schema = OutputErrorBlock.model_json_schema()
    blocks = {"study": schema, **schema["$defs"]}
    keys = [(block, key, part) for block, made in blocks.items() for key, part in made.get("properties", {}).items()]
    assert len(keys) > 80
    assert [f"{block}.{key}" for block, key, part in keys if not part.get("description")] == []
