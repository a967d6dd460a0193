"""The table of figures: which modules are measured, what they are measured by, and what makes it fail."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest

from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import load
from tests.benchmarks import __main__ as command
from tests.benchmarks import many_runs
from tests.benchmarks.figure import Figure, table

Capture = pytest.CaptureFixture[str]
Fake = Callable[[str, Figure], None]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Lets a module measure this figure at once."""

    def replace(name: str, figure: Figure) -> None:
        monkeypatch.setattr(import_module(f"tests.benchmarks.{name}"), "figures", lambda: [figure])

    return replace


@pytest.mark.parametrize("name", command.MODULES)
def test_every_module_that_is_offered_measures_something(name: str) -> None:
    assert callable(import_module(f"tests.benchmarks.{name}").figures)


def test_modules_run_in_the_order_of_the_table_and_all_when_none_is_named() -> None:
    assert command.chosen(["many_runs", "coverage_time"]) == ["coverage_time", "many_runs"]
    assert command.chosen([]) == list(command.MODULES)


def test_a_module_that_is_not_known_is_refused_before_anything_runs(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as refused:
        command.main(["many_runs", "many_rums"])
    assert refused.value.code == 2
    assert "there is no module many_rums; choose among coverage_frequency, " in capsys.readouterr().err


def test_help_names_every_module(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as shown:
        command.main(["--help"])
    assert shown.value.code == 0
    out = capsys.readouterr().out
    assert all(name in out for name in command.MODULES)


def test_progress_goes_to_stderr_and_the_table_has_a_group_a_module(fake: Fake, capsys: Capture) -> None:
    fake("loop_speed", Figure("a step", "-", "80 ns"))
    fake("many_runs", Figure("all runs", "at most 20 s", "2 s", True))
    assert command.main(["loop_speed", "many_runs"]) == 0
    out, err = capsys.readouterr()
    assert [line.split(":")[0] for line in err.splitlines()] == ["[1/2] many_runs", "[2/2] loop_speed"]
    lines = [line.split("  ")[0] for line in out.splitlines() if line]
    assert lines == ["name", "-" * 11, "many_runs:", "all runs", "loop_speed:", "a step"]


@pytest.mark.parametrize(("statistical", "code"), [(True, 1), (False, 0)])
def test_only_a_statistical_claim_that_does_not_hold_fails(fake: Fake, statistical: bool, code: int) -> None:
    fake("many_runs", Figure("a claim", "yes", "no", False, statistical))
    assert command.main(["many_runs"]) == code


def test_figures_without_a_group_are_one_table() -> None:
    lines = table({"": [Figure("a", "b", "c", True)]}).splitlines()
    assert lines == ["name  asked  measured  holds", "----  -----  --------  -----", "a     b      c         yes"]


def test_the_many_runs_differ_and_start_with_the_energies_that_are_promised() -> None:
    sets = many_runs.parameter_sets()
    assert len(sets) == many_runs.RUNS == len({tuple(each.values()) for each in sets})
    inertia, gravity, angle, speed = (
        np.array([each[f"hand.{name}"] for each in sets])
        for name in ("inertia", "gravity_torque", "angle_start", "speed_start")
    )
    share = (inertia * speed**2 / 2 + gravity * (1 - np.cos(angle))) / (gravity * (1 - np.cos(1.0)))
    assert share.min() > 0.6 - 1e-12 and share.max() < 1.4 + 1e-12
    assert np.ptp(share) > 0.7 and 0.2 < np.mean(angle > 0) < 0.8 and 0.2 < np.mean(speed > 0) < 0.8
    values = load(many_runs.SCENARIO, ScenarioBlock).values()
    assert set(sets[0]) >= {"controller.gain"} and not set(sets[0]) & (set(values) - {"controller.gain"})
