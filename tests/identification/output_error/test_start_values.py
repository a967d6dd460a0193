"""Windows that begin away from rest: which start values are missing, and the entries that end it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from identification.output_error.calibration import calibrate
from tests.support.identification.small_study import plain_study, record, study

pytestmark = pytest.mark.usefixtures("in_this_process")


def said(folder: Path, **changes: Any) -> tuple[str, ...]:
    """What a calibration with windows of 0.25 s, of which most begin in motion, says of its start values."""
    data = record(folder / "data")
    windows = {"windows": {"length": 0.25}, "validation": None, "options": {"max_evaluations": 1}}
    return calibrate(plain_study(**(windows | changes)), data).starts


def entry(warning: str) -> dict[str, Any]:
    """The entry that a warning says to write."""
    text = warning.split("`")[1]
    found = YAML(typ="safe").load("{" + text.replace("initial: ", "", 1) + "}")
    assert isinstance(found, dict)
    return found


def test_states_that_a_recording_tells_are_named_with_the_entry_that_ends_it(tmp_path: Path) -> None:
    angle, speed = said(tmp_path)
    assert entry(angle) == {"hand.angle_start": {"signal": "angle", "half_width": 0.025}}
    assert entry(speed) == {"hand.speed_start": {"signal": "angle", "derivative": 1, "half_width": 0.025}}
    assert "hand.speed_start = 0 rad/s, by up to" in speed and "`estimated: true` where" in speed
    assert said(tmp_path, initial=entry(angle) | entry(speed)) == ()


def test_a_factor_of_the_output_is_in_the_entry(tmp_path: Path) -> None:
    outputs = {"hand.angle": {"signal": "angle", "factor": 2.0}}
    entries = [keys for warning in said(tmp_path, outputs=outputs) for keys in entry(warning).values()]
    assert [keys["factor"] for keys in entries] == [2.0, 2.0]


def test_windows_that_begin_at_rest_ask_for_nothing(tmp_path: Path) -> None:
    """Noise alone, ten times as large as usual, looks like no motion."""
    data = record(tmp_path, noise=2e-3)
    one = plain_study(windows={"length": 1, "most": 1}, validation=None, options={"max_evaluations": 1})
    assert calibrate(one, data).starts == ()


def test_a_start_value_that_the_study_sets_is_meant(tmp_path: Path) -> None:
    components = study()["components"]
    components["hand"]["parameters"] |= {"speed_start": 0.0, "angle_start": 0.0}
    assert said(tmp_path, components=components) == ()
