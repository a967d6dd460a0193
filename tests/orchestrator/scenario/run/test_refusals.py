"""Every way to ask for something wrong is answered in one line, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import ScenarioError, WiringError
from orchestrator.scenario.run import run_scenario
from tests.support.simulation.falling import FALLING, refused

pytestmark = pytest.mark.usefixtures("scratch")


REFUSED = [
    ("title: A pendulum falls", "titel: A", ":2: titel: unknown key; did you mean 'title'?"),
    ("model: pendulum", "model: pendelum", "model 'pendelum': is not in the library"),
    ("model: pendulum", "model: pendulum, fmu: a.fmu", ":4: components.hand: give either `model` or `fmu`"),
    ("model: pendulum, ", "", ":4: components.hand: give either `model` or `fmu`"),
    ("model: pendulum", "fmu: missing.fmu", "missing.fmu: no such file"),
    ("hand: {", "my hand: {", ":3: components: component 'my hand': use letters, digits and underscores"),
    ("viscous_friction: 0.0", "viscous: 0.0", "hand.viscous: no variable 'viscous' in 'hand'; did you mean"),
    ("viscous_friction: 0.0", "viscous_friction: -1", "hand.viscous_friction: is -1, outside its bounds [0, inf)"),
    ("viscous_friction: 0.0", "viscous_friction: much", "hand.viscous_friction: cannot be 'much'; give a Real"),
    ("viscous_friction: 0.0", "viscous_friction: true", "hand.viscous_friction: cannot be true; give a Real"),
    ("step: 0.01", "step: 0.03", "stop: 1 s is not a multiple of 0.03 s; use 0.99 s"),
    ("step: 0.01", "step: 0", ":5: run: `step` must be positive and `stop` after `start`"),
    ("step: 0.01", "step: soon", ":5: run.step: 'soon' is no time"),
    (
        "step: 0.01",
        "step: 0.01, order: gauss_seidel",
        ":5: run.order: input should be 'gauss-seidel', 'jacobi' or 'iterated'",
    ),
    ("step: 0.01", "step: 0.01, start: 2", ":5: run: `step` must be positive and `stop` after `start`"),
    ("run:", "connections: [hand.angle]\nrun:", ":5: connections: 'hand.angle': write source -> target"),
    ("run:", "connections: [hand.angle -> hand.angle]\nrun:", "'hand.angle' is an output; only an input can be a"),
    ("run:", "connections: [hand.angle -> hand.torque]\nrun:", "hand.angle -> hand.torque: rad does not fit N.m"),
    ("run:", "record: [hand.angel]\nrun:", "hand.angel: no variable 'angel' in 'hand'; did you mean 'angle'?"),
    ("run:", "expect: [{signal: hand.angel, below: 1}]\nrun:", "hand.angel: no variable 'angel' in 'hand'"),
    ("run:", "expect: [{signal: hand.angle, below: 1, after: 7}]\nrun:", "expect hand.angle: there is no sample from"),
    ("run:", "cases: [{name: a, set: {hand.weight: 1}}]\nrun:", "hand.weight: no variable 'weight' in 'hand'"),
    ("run:", "cases: [{name: a}, {name: a}]\nrun:", "two cases have one name"),
    ("run:", "stimuli: {hand.angle: {constant: 1}}\nrun:", "'hand.angle' is an output; only an input can be"),
    ("run:", "stimuli: {hand.torque: {}}\nrun:", ":5: stimuli.hand.torque: give `constant`, or `file` and `signal`"),
    ("run:", "stimuli: {hand.torque: {file: a.csv}}\nrun:", ":5: stimuli.hand.torque: give `constant`, or `file` and"),
    ("run:", "stimuli: {hand.torque: {file: a.csv, signal: b}}\nrun:", "a.csv: there is no such file"),
    ("0.0}", "0.0}, tables: {a: {file: b.csv, signal: c}}", "b.csv: there is no such file"),
    ("0.0}", "0.0}, feed_through: some", ":4: components.hand.feed_through: input should be"),
    ("0.0}", "0.0}, step: -1/3", "hand.step: -1/3 s is not positive"),
]


@pytest.mark.parametrize(("old", "new", "line"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_wrong_is_one_line_that_names_the_place(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in FALLING
    assert line in refused(tmp_path, FALLING.replace(old, new))


def test_a_wrong_expectation_of_the_last_case_is_found_before_the_first_runs(tmp_path: Path) -> None:
    told: list[str] = []
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING + "cases: [{name: a}, {name: b, expect: [{signal: hand.x, below: 1}]}]")
    with pytest.raises(WiringError, match=r"hand\.x: no variable"):
        run_scenario(path, progress=lambda fraction, doing: told.append(doing))
    assert told == []


def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file"):
        run_scenario(tmp_path / "missing.yaml")
