"""Values given on the command line over a scenario."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import InputError, WiringError
from orchestrator.fmi.interface import Value, Written
from orchestrator.scenario.run import parse_override, run_scenario
from tests.support.simulation.falling import FALLING

pytestmark = pytest.mark.usefixtures("scratch")


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("hand.mass=1", "hand.mass", 1),
        ("hand.mass=1.0", "hand.mass", 1.0),
        (" hand.mass = -2e-3 ", "hand.mass", -2e-3),
        ("drive.on=true", "drive.on", True),
        ("drive.on=False", "drive.on", False),
        ("drive.shape=sine sweep", "drive.shape", "sine sweep"),
        ("drive.name=a=b", "drive.name", "a=b"),
        ("drive.name=", "drive.name", ""),
    ],
)
def test_overrides_are_read_as_number_truth_or_text(text: str, name: str, value: Value) -> None:
    read = parse_override(text)
    assert read[0] == name and isinstance(read[1], Written)
    assert read[1].read() == value and type(read[1].read()) is type(value)


@given(st.text(max_size=30))
def test_any_override_is_read_or_refused(text: str) -> None:
    try:
        name, _ = parse_override(text)
    except WiringError as error:
        assert "=" not in text
        assert re.search("has no value; write component.variable=value$", str(error))
    else:
        assert name == text.partition("=")[0].strip()


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999", "9" * 5000])
def test_an_override_that_is_no_number_is_refused(tmp_path: Path, value: str) -> None:
    name, parsed = parse_override(f"hand.gravity_torque={value}")
    overrides = {name: parsed}
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING)
    with pytest.raises((WiringError, InputError)) as failed:
        run_scenario(path, overrides)
    assert len(str(failed.value)) < 300
