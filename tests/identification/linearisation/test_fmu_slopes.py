"""FMUs in linear plants: their slopes are those of the models in them, by directional derivatives or by differences."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from fmus import library
from fmus.errors import IdentificationError
from fmus.packaging import targets
from identification.linearisation.equations import slopes
from identification.linearisation.fmu_slopes import fmu_slopes
from identification.linearisation.slopes import DIFFERENCES, DIRECTIONAL
from identification.tuning.sources.system_plant import PlantOutput, SystemPlant, independent
from orchestrator.assembly.assembly import ComponentSpec, SystemSpec
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.trace import FloatArray

STEP = 1 / 300
SMOOTH = {"bristle_stiffness": 1e-6, "bristle_damping": 0.0, "payload": 0.2}
pytestmark = pytest.mark.slow  # each builds an FMU


def built(folder: Path, name: str, fmi: int, *, directional: bool = True, target: str = "native") -> Path:
    """The FMU of a model, which may be silent about its directional derivatives."""
    file = targets.build(library.find(name), folder / f"{name}.fmu", target=target, fmi=fmi)
    if directional:
        return file
    silent = folder / f"silent_{name}.fmu"
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(silent, "w") as changed:
        for entry in source.namelist():
            content = source.read(entry)
            if entry == "modelDescription.xml":
                for flag in (b"providesDirectionalDerivatives", b"providesDirectionalDerivative"):
                    content = content.replace(flag + b'="true"', flag + b'="false"')
                assert b'Derivative="true"' not in content
            changed.writestr(entry, content)
    return silent


def plant(arm: ComponentSpec, **spread: float) -> SystemPlant:
    system = SystemSpec({"drive": ComponentSpec("servo_drive"), "arm": arm}, (("drive.torque", "arm.torque"),))
    outputs = {"angle": PlantOutput("arm.angle"), "strain": PlantOutput("arm.middle_strain", 1e4, "V")}
    return SystemPlant(system, {"u": "drive.voltage"}, outputs, independent(spread))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("directional", [True, False])
def test_an_fmu_has_the_slopes_of_its_model_whatever_they_are_found_by(
    fmi: int, directional: bool, tmp_path: Path
) -> None:
    """Directional derivatives are exact, so that only the model's own differences are rounded."""
    found = fmu_slopes("arm", built(tmp_path, "flexible_arm", fmi, directional=directional), SMOOTH)
    known = slopes("arm", library.find("flexible_arm"), SMOOTH)
    rows = [found.outputs.index(name) for name in known.outputs]
    assert found.a == pytest.approx(known.a, rel=1e-6, abs=1e-9 * np.abs(known.a).max())
    assert found.b == pytest.approx(known.b, rel=1e-6)
    assert found.c[:, rows] == pytest.approx(known.c, rel=1e-6, abs=1e-6)
    assert found.by == (DIRECTIONAL if directional else DIFFERENCES)


def test_directional_derivatives_that_are_wrong_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, told = built(tmp_path, "flexible_arm", 2), ExchangeSlave.directional

    def wrong(slave: ExchangeSlave) -> FloatArray | None:
        found = told(slave)
        return None if found is None else 1.01 * found

    monkeypatch.setattr(ExchangeSlave, "directional", wrong)
    with pytest.raises(IdentificationError, match=r"arm: has directional derivatives that .* do not bear out; ask"):
        fmu_slopes("arm", file, SMOOTH)


def test_a_plant_with_an_fmu_is_that_with_its_model_and_tells_how(tmp_path: Path) -> None:
    file = built(tmp_path, "flexible_arm", 2)
    found, known = (
        plant(ComponentSpec(source, SMOOTH)).linear("plants.arm", STEP) for source in (file, "flexible_arm")
    )
    omega = np.geomspace(1, 300, 40)
    assert found.model.frequency_response(omega) == pytest.approx(known.model.frequency_response(omega), rel=1e-6)
    [remark] = found.remarks
    assert remark == "plants.arm.components.arm (flexible_arm.fmu) is linearised by its directional derivatives"
    assert known.remarks == ()
