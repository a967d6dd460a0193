"""Parameters that are free, fixed, tied, or not to be told apart by what was recorded."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from fmus.packaging import archive, defaults
from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.identification.small_study import (
    COUNT,
    STEP,
    TRUTH,
    calibrated,
    simulated,
    summary,
    voltage,
    write_study,
)

pytestmark = pytest.mark.usefixtures("in_this_process")


def test_fixed_parameters_stay_and_have_no_interval(data: Path, tmp_path: Path) -> None:
    parameters = {name: {"start": value, "fixed": True} for name, value in TRUTH.items()}
    parameters["hand.inertia"] = {"start": 0.006, "min": 0.001}
    document = calibrated(write_study(tmp_path / "study.yaml", parameters=parameters), data, tmp_path / "out")
    gain, inertia = document["parameters"]["motor.torque_gain"], document["parameters"]["hand.inertia"]
    assert (gain["value"], gain["std"], gain["ci95"]) == (8.0, None, None)
    low, high = inertia["ci95"]
    assert low <= TRUTH["hand.inertia"] <= high


def test_a_tied_parameter_follows_with_its_interval(tmp_path: Path) -> None:
    friction = {"hand.coulomb_friction_positive": 4e-3, "hand.coulomb_friction_negative": 2e-3}
    truth = TRUTH | friction
    write_recordings(tmp_path / "data", truth)
    known = {name: {"start": value, "fixed": True} for name, value in TRUTH.items()}
    parameters = known | {
        "hand.coulomb_friction_negative": {"start": 1e-3, "min": 0},
        "hand.coulomb_friction_positive": {"tied": "hand.coulomb_friction_negative", "factor": 2},
    }
    study_file = write_study(tmp_path / "study.yaml", parameters=parameters, truth=truth)
    document = calibrated(study_file, tmp_path / "data", tmp_path / "out")
    positive, negative = (document["parameters"][name] for name in friction)
    assert positive["value"] == 2 * negative["value"] and positive["std"] == 2 * negative["std"]
    assert positive["ci95"] == [2 * end for end in negative["ci95"]] and positive["start"] is None
    for name, value in friction.items():
        low, high = document["parameters"][name]["ci95"]
        assert low <= value <= high
    used = defaults.load(archive.read(tmp_path / "out" / "fmus" / "hand.fmu")[defaults.RESOURCE].decode())
    assert used["coulomb_friction_positive"] == positive["value"]


def write_recordings(folder: Path, truth: Mapping[str, float], noise: float = 2e-4) -> None:
    """The recordings of the small study, of another rig."""
    folder.mkdir()
    for number, (name, mass) in enumerate({"rig_0__a": 0.0, "rig_50__b": 0.05, "rig_100__c": 0.1}.items()):
        angle = simulated(voltage(number), mass, truth) + np.random.default_rng(number).normal(0, noise, COUNT)
        trace = Trace(np.arange(COUNT) * STEP, {"voltage": voltage(number), "angle": angle})
        formats.write(trace, folder / f"{name}.csv")


def test_back_emf_and_viscous_friction_are_named_as_one_sum(data: Path, tmp_path: Path) -> None:
    """The motor sees the speed a step late, which tells the two apart in theory; in practice only their sum is seen."""
    both = {"hand.viscous_friction": {"start": 0.001, "min": 0}, "motor.back_emf": {"start": 5e-5, "min": 0}}
    known = {name: {"start": TRUTH[name], "fixed": True} for name in TRUTH if name not in both}
    study_file = write_study(tmp_path / "study.yaml", parameters=known | both)
    document = calibrated(study_file, data, tmp_path / "out")
    (message,) = document["uncertainty"]["weak"]
    assert "hand.viscous_friction and motor.back_emf: hardly more than a sum of them is seen" in message
    weight = re.search(r"hand\.viscous_friction \+ (\S+) \* motor\.back_emf", message)
    assert weight is not None and float(weight[1]) == pytest.approx(TRUTH["motor.torque_gain"], rel=0.01)
    assert message in document["warnings"]
    total = (
        document["parameters"]["hand.viscous_friction"]["value"] + 8 * document["parameters"]["motor.back_emf"]["value"]
    )
    assert total == pytest.approx(TRUTH["hand.viscous_friction"], rel=0.02)
    assert message in (tmp_path / "out" / "report.html").read_text()
    assert summary(tmp_path / "out") == document


def test_what_has_exactly_the_same_effect_is_named_and_has_no_interval(data: Path, tmp_path: Path) -> None:
    parameters = {name: {"start": TRUTH[name], "fixed": True} for name in TRUTH if name != "motor.torque_gain"}
    parameters |= {
        name: {"start": start, "min": 0.1}
        for name, start in (("motor.torque_gain", 7.0), ("motor.resistance", 2.0), ("hand.gravity", 9.8))
    }
    document = calibrated(write_study(tmp_path / "study.yaml", parameters=parameters), data, tmp_path / "out")
    assert document["uncertainty"]["unseen"] == ["motor.resistance has no effect on the outputs"]
    assert document["uncertainty"]["unseen"][0] in document["warnings"]
    resistance, gain = document["parameters"]["motor.resistance"], document["parameters"]["motor.torque_gain"]
    assert resistance["std"] is None and resistance["ci95"] == [None, None]
    low, high = gain["ci95"]
    assert low <= 8 <= high
    assert summary(tmp_path / "out") == document
