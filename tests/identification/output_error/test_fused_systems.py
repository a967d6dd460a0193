"""A system as one FMU in a calibration: its parameters are found by their dotted names, and written back inside."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.packaging import targets
from fmus.packaging.native import compiler
from identification.calibrate import calibrate_study
from identification.output_error import calibration
from orchestrator.trace import FloatArray
from tests.support.fmus.either import opened
from tests.support.identification.small_study import COUNT, STEP, TRUTH, record, simulated, study, voltage
from tests.support.simulation.fused import fused

pytestmark = [
    pytest.mark.slow,  # a compiler
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]


def rig(folder: Path, fmi: int = 2, nested: Sequence[str] = ()) -> Path:
    """The FMU of the small study's motor and hand, driven by a voltage; the `nested` ones are FMUs in it."""
    own = study()
    components = {name: dict(component) for name, component in own["components"].items()}
    for name in nested:
        model = components[name].pop("model")
        components[name]["fmu"] = str(targets.build(model, folder / f"{model}.fmu", target="native", fmi=fmi))
    document = {
        "title": "A rig",
        "components": components,
        "connections": own["connections"],
        "stimuli": {"motor.voltage": {"constant": 0}},
        "run": {"stop": 1, "step": STEP},
    }
    (folder / "rig.yaml").write_text(json.dumps(document))
    return fused(folder / "rig.yaml", folder, fmi)


def in_the_rig(names: dict[str, Any]) -> dict[str, Any]:
    return {f"rig.{name}": value for name, value in names.items()}


def moved(path: Path) -> FloatArray:
    """(K,) the angle that the FMU shows with nothing set [rad]."""
    driven, angle = voltage(0), list[float]()
    with opened(path) as fmu:
        fmu.start(**{"motor.voltage": float(driven[0])})
        angle += fmu.get("hand.angle")
        for k in range(COUNT - 1):
            fmu.set("motor.voltage", float(driven[k]))
            fmu.step(k * STEP, STEP)
            angle += fmu.get("hand.angle")
    return np.array(angle)


@pytest.mark.parametrize(
    ("fmi", "nested", "differences"),
    [(2, (), ""), (3, (), ""), (2, ("hand", "motor"), "carries no tangents"), (3, ("hand",), "carries no tangents")],
)
def test_parameters_inside_are_found_and_the_fmu_that_is_written_back_moves_by_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmi: int, nested: Sequence[str], differences: str
) -> None:
    """Models carry tangents, FMUs inside do not."""
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    own, path = study(), rig(tmp_path, fmi, nested)
    document = own | {
        "components": {"rig": {"fmu": str(path)}},
        "connections": [],
        "traces": own["traces"] | {"values": {"rig.hand.added_mass": "mass"}},
        "inputs": in_the_rig(own["inputs"]),
        "outputs": in_the_rig(own["outputs"]),
        "parameters": in_the_rig(own["parameters"]),
        "truth": in_the_rig(own["truth"]),
    }
    (tmp_path / "study.yaml").write_text(json.dumps(document))
    summary = calibrate_study(tmp_path / "study.yaml", record(tmp_path / "data"), tmp_path / "out", lambda *_: None)
    found = {name: entry["value"] for name, entry in summary["parameters"].items()}
    assert differences in summary["search"]["differences"]
    assert bool(summary["search"]["differences"]) == bool(nested)
    for name, entry in summary["parameters"].items():
        assert entry["ci95"][0] <= TRUTH[name.removeprefix("rig.")] <= entry["ci95"][1], name
    written = next((tmp_path / "out").rglob("rig.fmu"))
    with opened(written) as fmu:
        fmu.start()
        values = {name.removeprefix("rig."): value for name, value in found.items()}
        assert fmu.get(*values) == [*values.values()]
    assert moved(written) == pytest.approx(simulated(voltage(0), 0.0, values), rel=1e-9, abs=1e-12)
    assert moved(path) != pytest.approx(moved(written), rel=1e-2)
