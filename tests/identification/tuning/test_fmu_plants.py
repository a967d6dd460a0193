"""Plants of FMUs, whoever supplies them: their slopes are those of the equations that they were made of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import library
from fmus.errors import IdentificationError, InputError
from fmus.packaging.native.build import build
from fmus.parameters import ssv
from identification import tune
from identification.linearisation.equations import slopes
from identification.linearisation.fmu_slopes import fmu_slopes
from identification.linearisation.slopes import Slopes
from tests.support.identification.tuning_study import driven, write

pytestmark = pytest.mark.slow
SMOOTH = {"bristle_stiffness": 1e-6, "bristle_damping": 0.0}


def fmu(name: str, folder: Path, fmi: int = 2) -> Path:
    return build(library.find(name), folder / f"{Path(name).stem}.fmu", fmi=fmi)


def response(found: Slopes, number: int, outputs: tuple[str, ...]) -> np.ndarray:
    """Of these outputs at some frequencies, whatever the states' order."""
    a, b, c, d = (getattr(found, name)[number] for name in "abcd")
    rows = [found.outputs.index(name) for name in outputs]
    points = 1j * np.array([0.3, 3.0, 30.0, 130.0])
    return np.array([c[rows] @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d[rows] for s in points])


@pytest.mark.parametrize("fmi", [2, 3])
def test_slopes_of_an_fmu_are_those_of_its_equations(tmp_path: Path, fmi: int) -> None:
    payloads = np.array([0.0, 0.3])
    found = fmu_slopes("arm", fmu("flexible_arm", tmp_path, fmi), {**SMOOTH, "payload": payloads}, 2)
    known = slopes("arm", library.find("flexible_arm"), {**SMOOTH, "payload": payloads}, 2)
    for number in range(2):
        outputs = ("angle", "speed", "middle_strain")
        expected = response(known, number, outputs)
        assert response(found, number, outputs) == pytest.approx(expected, rel=1e-4, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("pdp", {}, "has no Model Exchange.*identify a linear model of it"),
        ("flexible_arm", {"backlash": 2e-5}, "jumps or bends where it rests"),
        ("pendulum", {"angle_start": 0.3}, "does not rest where it starts"),
    ],
)
def test_an_fmu_without_slopes_at_rest_is_refused(
    tmp_path: Path, name: str, values: dict[str, float], problem: str
) -> None:
    with pytest.raises(IdentificationError, match=problem):
        fmu_slopes("plant", fmu(name, tmp_path), values)


def study_of(folder: Path, load: dict[str, Any], **plant: Any) -> Path:
    document = driven(folder)
    [found] = document["plants"].values()
    found["components"]["load"] = load
    found |= plant
    return write(folder, document)


def test_a_controller_is_tuned_for_an_fmu_with_a_parameter_set_as_for_the_model(tmp_path: Path) -> None:
    driven(tmp_path)  # which writes the load's model
    fmu(str(tmp_path / "load.py"), tmp_path)
    (tmp_path / "heavy.ssv").write_bytes(ssv.parameter_set("heavy", {"load.inertia": 0.2}, {"load.inertia": "kg.m2"}))
    spread = {"spread": {"load.damping": 0.02}}
    by_model = tune(study_of(tmp_path, {"model": "load.py", "parameters": {"inertia": 0.2}}, **spread)).summary
    by_fmu = tune(study_of(tmp_path, {"fmu": "load.fmu"}, parameters="heavy.ssv", **spread)).summary
    gains = [each["parameters"]["controller.kp"]["value"] for each in (by_model, by_fmu)]
    assert gains[0] == pytest.approx(gains[1], rel=1e-4)
    lighter = tune(study_of(tmp_path, {"fmu": "load.fmu"})).summary["parameters"]["controller.kp"]["value"]
    assert lighter != pytest.approx(gains[0], rel=1e-2)


def test_a_parameter_set_of_no_component_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.ssv").write_bytes(ssv.parameter_set("other", {"arm.inertia": 0.2}, {}))
    with pytest.raises(InputError, match="no component 'arm'"):
        tune(study_of(tmp_path, {"model": "load.py"}, parameters="other.ssv"))
