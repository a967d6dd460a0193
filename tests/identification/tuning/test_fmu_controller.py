"""Controllers as FMUs: linear as their equations are, tuned like models, and written back as their makers allow."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import library
from fmus.errors import IdentificationError, InputError
from fmus.packaging import archive, targets
from identification import tune
from identification.calibrate import study_without_data
from identification.tuning.sources.fmu_controller import FmuController
from identification.tuning.sources.model_controller import ModelController
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.file import FmuDescription
from orchestrator.progress import silent
from tests.support.identification.tuning_study import STEP, study, write
from tests.support.ssv import read_values


def controller(file: Path, step: str = "1/100", **parameters: float) -> FmuController:
    spec = ComponentSpec(file, {"sample_time": float(Fraction(step)), **parameters})
    return FmuController("controller", spec, FmuDescription(file).interface, Fraction(step))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pdp", "pi", "notch"])
@pytest.mark.parametrize("target", ["native", "python"])
def test_an_fmu_is_linear_as_its_equations_are(name: str, target: str, tmp_path: Path) -> None:
    found = controller(targets.build(name, tmp_path / f"{name}.fmu", target=target)).linear({})
    known = ModelController("controller", library.find(name), {"sample_time": STEP}).linear({})
    omega = np.geomspace(0.1, 0.99 * np.pi / STEP, 30)
    assert (found.inputs, found.outputs, found.order) == (known.inputs, known.outputs, known.order)
    assert found.frequency_response(omega) == pytest.approx(known.frequency_response(omega), abs=1e-9)


@pytest.mark.slow
def test_an_fmu_that_is_not_linear_where_it_rests_is_refused(tmp_path: Path) -> None:
    file = targets.build("pdpc", tmp_path / "pdpc.fmu")
    with pytest.raises(IdentificationError, match=r"controller\.\w+: is not linear where the controller rests"):
        controller(file, error_band=0.0, speed_band=0.0)


def given(file: Path, **more: Any) -> dict[str, Any]:
    return {"controller": {"fmu": str(file), "parameters": {"sample_time": STEP, "ki": 0}} | more}


def test_an_fmu_is_tuned_to_what_its_model_is(tmp_path: Path) -> None:
    file = targets.build("pi", tmp_path / "pi.fmu")
    by_fmu, by_model = (tune(write(tmp_path, study(**how))).parameters["controller.kp"] for how in (given(file), {}))
    assert by_fmu["value"] == pytest.approx(by_model["value"], rel=1e-6)


def test_values_for_an_fmu_of_another_supplier_lie_beside_it(tmp_path: Path) -> None:
    files = archive.read(targets.build("pi", tmp_path / "pi.fmu"))
    files["modelDescription.xml"] = files["modelDescription.xml"].replace(b'"servotwin"', b'"another tool"')
    archive.write(tmp_path / "theirs.fmu", files)
    found = study_without_data(
        "tune", write(tmp_path, study(**given(tmp_path / "theirs.fmu"))), tmp_path / "out", silent
    )
    written = tmp_path / "out" / "fmus"
    assert read_values(written / "controller.ssv")["kp"] == found["parameters"]["controller.kp"]["value"]
    assert archive.read(written / "controller.fmu") == files


def test_an_fmu_that_does_not_tell_how_it_samples_needs_a_step(tmp_path: Path) -> None:
    file = targets.build("servo_drive", tmp_path / "drive.fmu")
    bare = {"controller": {"fmu": str(file)}}
    with pytest.raises(InputError, match=r"controller: does not tell how often it samples; give its `step`"):
        tune(write(tmp_path, study(**bare)))
