"""A controller that has values of its own around each plant, as a schedule of gains has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError
from identification import tune
from identification.linear.model import LinearModel
from tests.support.identification.tuned_loops import known
from tests.support.identification.tuning_study import STEP, driven, lagging, study, write


def scheduled(**plants: dict[str, Any]) -> dict[str, Any]:
    given = {"light": {"matrices": lagging(2.0)}, "heavy": {"matrices": lagging(1.0)}}
    return study(
        plants={name: plant | plants.get(name, {}) for name, plant in given.items()},
        goals=[{"measure": name, "at_least": 0} for name in ("gain margin", "phase margin", "modulus margin")],
        minimise=[],
        design={"by": "given"},
    )


def figures(folder: Path, document: dict[str, Any]) -> dict[str, dict[str, float | None]]:
    summary: Any = tune(write(folder, document)).summary
    return {goal["measure"]: goal["figures"] for goal in summary["goals"]}


def test_margins_around_each_plant_are_those_of_python_control(tmp_path: Path) -> None:
    gains = {"light": 0.7, "heavy": 2.5}
    found = figures(tmp_path, scheduled(**{name: {"controller": {"kp": kp}} for name, kp in gains.items()}))
    for name, load in (("light", 2.0), ("heavy", 1.0)):
        a, b, c = (np.array(lagging(load)[matrix]) for matrix in "ABC")
        wanted = known(LinearModel(a, b, c, np.zeros((1, 1)), STEP, ("u",), ("y",)), gains[name])
        assert found["gain margin"][name] == pytest.approx(wanted.gain, abs=1e-5)
        assert found["phase margin"][name] == pytest.approx(wanted.phase, abs=1e-5)
        assert found["modulus margin"][name] == pytest.approx(wanted.modulus, abs=1e-6)


def test_they_win_over_what_is_found(tmp_path: Path) -> None:
    """kp is sought by the light load's margin; around the heavy one it is what the study says."""
    document = scheduled(heavy={"controller": {"kp": 0.3}}) | {
        "goals": [{"measure": "phase margin", "at_least": 60}],
        "minimise": [{"measure": "itae"}],
        "design": {"unknowns": {"kp": {"start": 0.5, "min": 0.01, "max": 20}}},
    }
    margin = figures(tmp_path, document)["phase margin"]
    alone = figures(tmp_path, scheduled(heavy={"controller": {"kp": 0.3}}))["phase margin"]
    assert margin["light"] == pytest.approx(60, abs=1e-3)
    assert margin["heavy"] == pytest.approx(alone["heavy"])


def test_unstable_loops_have_no_margins(tmp_path: Path) -> None:
    wild = {"controller": {"kp": 1e3}}
    assert figures(tmp_path, scheduled(light=wild))["phase margin"]["light"] is None
    assert figures(tmp_path, scheduled(light=wild))["phase margin"]["heavy"] is not None
    assert set(figures(tmp_path, scheduled(light=wild, heavy=wild))["phase margin"].values()) == {None}


def test_draws_of_a_plant_have_its_values(tmp_path: Path) -> None:
    document = driven(tmp_path, spread={"load.inertia": 1e-6}, controller={"kp": 0.01})
    document |= {"minimise": [], "design": {"by": "given"}, "draws": {"count": 3}}
    summary: Any = tune(write(tmp_path, document)).summary
    assert summary["draws"]["unseen"]["goals"][0]["percentiles"][2] == pytest.approx(
        summary["goals"][0]["figures"]["load"], rel=1e-3
    )


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"gain": 1}, r"plants\.light: controller\.gain: .*"),
        ({"kp": "3 kg"}, r"plants\.light: controller\.kp: .*"),
        ({"sample_time": -1}, r"plants\.light: controller\.sample_time: .*"),
    ],
)
def test_values_that_it_does_not_take_are_refused(tmp_path: Path, given: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        tune(write(tmp_path, scheduled(light={"controller": given})))
