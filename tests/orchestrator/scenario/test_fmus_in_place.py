"""An FMU in place of a scenario's component: it behaves by the values in it, and nothing of the component's is set."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus import library
from fmus.errors import InputError, ScenarioError
from fmus.packaging import targets
from fmus.parameters.write_back import write_back
from orchestrator.cli.options import files
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import load_scenario

SWINGING = """
title: A pendulum swings
components:
  hand: {model: pendulum, parameters: {inertia: 0.004, angle_start: 1.0}}
run: {stop: 1, step: 0.01}
cases:
  - {name: as it is}
  - {name: from farther off, set: {hand.angle_start: 2.0}}
"""


@pytest.fixture
def swinging(tmp_path: Path) -> Path:
    file = tmp_path / "swinging.yaml"
    file.write_text(SWINGING)
    return file


@pytest.fixture(scope="module")
def heavier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pendulum whose values are in its FMU."""
    folder = tmp_path_factory.mktemp("heavier")
    built = targets.build(library.find("pendulum"), folder / "built.fmu")
    write_back(built, {"inertia": 0.006, "angle_start": 1.0}, folder / "heavier.fmu", {})
    return folder / "heavier.fmu"


def test_it_has_the_values_in_it_and_those_of_cases(swinging: Path, heavier: Path) -> None:
    found = run_scenario(load_scenario(swinging, fmus={"hand": heavier}))
    wanted = run_scenario(swinging, {"hand.inertia": 0.006})
    for one, other in zip(found.cases, wanted.cases, strict=True):
        assert one.trace == other.trace


def test_what_is_not_there_is_refused(swinging: Path, heavier: Path, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="--fmu arm: no such component; there are hand"):
        load_scenario(swinging, fmus={"arm": heavier})
    with pytest.raises(ScenarioError, match=r"no file .*none\.fmu"):
        load_scenario(swinging, fmus={"hand": tmp_path / "none.fmu"})


@pytest.mark.parametrize("text", ["controller", "=file.fmu", "controller="])
def test_an_option_that_is_not_component_and_file_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not COMP=FILE"):
        files([text])
