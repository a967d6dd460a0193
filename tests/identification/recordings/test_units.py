"""Recordings of one campaign in several units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.errors import WiringError
from identification.recordings.campaign import StudyTrace, recording_warnings
from identification.recordings.units import in_common_units, in_units, unit_documents
from orchestrator.crossing import named
from orchestrator.trace import Trace


def recorded(name: str, unit: str | None) -> StudyTrace:
    trace = Trace(np.arange(3.0), {"u": [1.0, 2.0, 3.0], "other": [0.0] * 3}, {"u": unit} if unit else {}, name)
    return StudyTrace(trace, {}, Path(f"{name}.csv"), "00", "fine")


def test_all_recordings_come_in_the_unit_of_the_first_that_tells_one() -> None:
    found = in_common_units([recorded("a", None), recorded("b", "mV"), recorded("c", "V")], ["u"])
    assert [known.trace["u"].tolist() for known in found] == [[1, 2, 3], [1, 2, 3], [1000, 2000, 3000]]
    assert [known.trace.unit("u") for known in found] == ["mV"] * 3
    assert [told["text"] for told in unit_documents(found)] == ["u: V to mV, times 1000"]


def test_a_recording_of_another_quantity_is_refused_and_an_unknown_unit_is_a_warning() -> None:
    with pytest.raises(WiringError, match=r"^b\.csv: u: A does not fit V"):
        in_units([recorded("a", "V"), recorded("b", "A")], {"u": named("V")})
    assert recording_warnings(in_units([recorded("a", "V_rms")], {"u": named("V")})) == [
        "u: V_rms is taken for V as it is, by factor 1"
    ]
