"""Parts of recordings kept out of a fit: every sample is fitted or held out, none is both."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import ScenarioError
from identification.calibrate import calibrate
from identification.recordings.parts import RecordingPart, parted
from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white

TRACE = Trace(np.arange(100) * 0.1, {"y": np.arange(100.0)}, {}, "rig")


@pytest.mark.parametrize(
    "part",
    [
        RecordingPart("rig", 5.05),
        RecordingPart("rig", stop=2.05),
        RecordingPart("rig", 3.05, 6.05),
        RecordingPart("rig", -math.inf, 0.15),
    ],
)
def test_every_sample_is_fitted_or_held_out(part: RecordingPart) -> None:
    (left, marks), (own, _) = parted(TRACE, [part])
    fitted = {float(t) for t in left.time if not any(m.start < t < m.stop for m in marks)}
    assert fitted | {float(t) for t in own.time} == {float(t) for t in TRACE.time}
    assert not fitted & {float(t) for t in own.time} and own.name == part.name and left.name == "rig"


@pytest.mark.parametrize("part", [RecordingPart("rig", 20.0), RecordingPart("rig", -1.0)])
def test_a_part_that_is_empty_or_all_is_refused(part: RecordingPart) -> None:
    with pytest.raises(ScenarioError, match=r"traces\.hold_out"):
        list(parted(TRACE, [part]))


def test_a_study_fits_one_part_of_a_recording_and_is_judged_on_the_other(tmp_path: Path) -> None:
    plant, u = model_of([eigenvalue(9.0, 0.03)], outputs=1), white(900, seed=1)
    signals = {"u": u[:, 0], "y": plant.simulate(u)[:, 0]}
    formats.write(Trace(STEP * np.arange(900), signals, {}, "rig"), tmp_path / "rig.csv")
    part = f"{{trace: rig, from: {600.5 * STEP}}}"
    study = tmp_path / "study.yaml"
    keys = "inputs: [u]\noutputs: [y]\norder: 2\nblock: 10\n"
    study.write_text(
        f"title: halves\nmethod: subspace\ntraces: {{files: 'rig.csv', hold_out: [{part}]}}\n{keys}", encoding="utf-8"
    )
    summary = calibrate(study, tmp_path).summary
    assert [(one["trace"], one["role"]) for one in summary["data"]] == [
        ("rig", "fit"),
        (f"rig from {600.5 * STEP:g} s", "held out"),
    ]
    validation = summary["fit"]["validation"]
    assert validation is not None and (validation["median"] or 0) > 0.99
