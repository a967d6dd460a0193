"""Noisy scenarios are judged by what their noise allows, and the chance of a false failure is stated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fmus.errors import ScenarioError
from orchestrator import formats
from orchestrator.report import Chart
from orchestrator.report.content import DrawnFigure
from orchestrator.scenario.expectations import Check, Draws, Ran
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.scenario.report import report
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.simulation.expecting import wiring

TIME = np.linspace(0.0, 5.0, 501)


def draw(seed: int, mean: float = 1.0) -> Trace:
    noise = np.random.default_rng(seed).standard_normal(len(TIME))
    return Trace(TIME, {"y": mean - np.exp(-TIME) + 0.05 * noise}, {"y": "V"}, f"seed {seed}")


def judged(fields: dict[str, Any], folder: Path, count: int = 50, mean: float = 1.0, **more: Any) -> Check:
    expected = ExpectationBlock(signal="y", **fields).expectation(folder).brought(wiring(draw(0)))
    draws = [draw(seed, mean) for seed in range(1, count + 1)]
    return expected.check(Ran(draw(0, mean), draws={(): draws}, **more))


@pytest.fixture
def band(tmp_path: Path) -> dict[str, Any]:
    formats.write(draw(1000), tmp_path / "reference.csv")
    return {"reference": {"file": "reference.csv"}, "band": {"seeds": 50}}


def test_a_reference_that_is_one_more_draw_lies_in_the_band_and_one_of_another_system_does_not(
    tmp_path: Path, band: dict[str, Any]
) -> None:
    held = judged(band, tmp_path)
    assert held.held and held.figure is not None and held.figure > 1 / 51
    assert "fails by chance with 0.02" in held.text
    failed = judged(band, tmp_path, mean=1.2)
    assert not failed.held and failed.figure == pytest.approx(1 / 51)
    assert failed.margin is not None and failed.margin < 0


def test_a_band_without_enough_draws_does_not_hold(tmp_path: Path, band: dict[str, Any]) -> None:
    check = judged(band, tmp_path, count=49)
    assert (check.held, check.found) == (False, "there are no draws: noise is drawn again in plain runs only")


def test_a_bound_holds_of_a_share_of_the_runs() -> None:
    largest = sorted(float(draw(seed)["y"].max()) for seed in range(51))
    limit = (largest[45] + largest[46]) / 2  # 46 of 51 are below
    fields = {"below": limit, "seeds": 50}
    assert judged({**fields, "share": "90 %"}, Path()).held
    failed = judged({**fields, "share": "91 %"}, Path())
    assert not failed.held and failed.figure == pytest.approx(46 / 51)
    assert "held in 46 of 51 runs, so in 78.6 to 96.7 % of all such" in failed.found
    assert failed.text == f"y stays below {limit:g} V in 91 % of 51 runs with other noise"


def test_draws_are_asked_for_by_signal_and_by_what_varies(tmp_path: Path) -> None:
    plain = ExpectationBlock(signal="y", below=1, seeds=20, share=0.9)
    some = ExpectationBlock(signal="u", below=1, seeds=30, share=0.9, vary=["encoder"])
    assert ExpectationBlock(all=[plain, some]).expectation(tmp_path).drawn == (
        ("y", Draws(20)),
        ("u", Draws(30, ("encoder",))),
    )


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"below": 1, "seeds": 50}, "`seeds` and `share` go together"),
        ({"below": 1, "share": 0.9}, "`seeds` and `share` go together"),
        ({"below": 1, "vary": ["a"]}, "`vary` goes with `seeds`"),
        (
            {"reference": "accepted", "band": {"seeds": 50, "failure": "1 %"}},
            "cannot fail: a `failure` of 0.01",
        ),
        ({"reference": "accepted", "band": {"seeds": 50, "quantiles": [0.6, 0.9]}}, "must lie on both sides of 0.5"),
        ({"reference": "accepted", "band": {"seeds": 50}, "seeds": 9, "share": 1}, "`band` has `seeds` of its own"),
        ({"band": {"seeds": 50}}, "`band` goes with `reference`"),
    ],
)
def test_what_makes_no_sense_is_refused(fields: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        ExpectationBlock(signal="y", **fields)


SCENARIO = """
title: a noisy channel
components:
  source: {{model: excitation, parameters: {{shape: sine, amplitude: 1, frequency: 0.5}}}}
  channel: {{model: daq, parameters: {{sample_time: 0.01, noise: 0.1{seed}}}}}
connections: [source.signal -> channel.signal]
run: {{stop: 2, step: 0.01}}
expect: [{expect}]
"""


def run(folder: Path, expect: str, seed: str = ", seed: 7", **overrides: float) -> Check:
    (folder / "noisy.yaml").write_text(SCENARIO.format(expect=expect, seed=seed))
    given = {name.replace("__", "."): value for name, value in overrides.items()}
    result = run_scenario(folder / "noisy.yaml", given)
    return result.cases[0].checks[0]


@pytest.mark.slow
def test_a_scenario_is_run_again_with_other_seeds(tmp_path: Path) -> None:
    formats.write(run_trace(tmp_path, 99), tmp_path / "reference.parquet")
    band = "{signal: channel.measured, reference: {file: reference.parquet}, band: {seeds: 30}}"
    assert run(tmp_path, band).held
    failed = run(tmp_path, band, source__amplitude=2.0)
    assert not failed.held and failed.figure == pytest.approx(1 / 31)
    often = "{signal: channel.measured, below: 1.2, seeds: 30, share: 50 %}"
    check = run(tmp_path, often)
    assert check.figure is not None and 0 < check.figure < 1


@pytest.mark.slow
def test_the_report_draws_the_band_of_other_seeds_which_the_reference_keeps_to(tmp_path: Path) -> None:
    formats.write(run_trace(tmp_path, 99), tmp_path / "reference.parquet")
    asked = "{signal: channel.measured, reference: {file: reference.parquet}, band: {seeds: 30}}"
    assert run(tmp_path, f"{asked}, {{signal: channel.measured, near: 0, within: 2, seeds: 30, share: 50 %}}").held
    page = report(run_scenario(tmp_path / "noisy.yaml"))
    [chart] = [
        piece.drawing
        for section in page.sections
        for piece in section.content
        if isinstance(piece, DrawnFigure) and isinstance(piece.drawing, Chart)
    ]
    [panel] = [panel for panel in chart.panels if panel.title.startswith("channel.measured")]
    band, tube = panel.bands
    _, reference, _ = panel.curves
    lower, upper, values = (np.asarray(one) for one in (band.lower, band.upper, reference.y))
    assert np.all((lower <= values) & (values <= upper)) and 0.2 < float(np.mean(upper - lower)) < 1.0
    assert np.all(np.asarray(tube.upper) == 2)


def run_trace(folder: Path, seed: int) -> Trace:
    (folder / "once.yaml").write_text(SCENARIO.format(expect="", seed=f", seed: {seed}"))
    return run_scenario(folder / "once.yaml").cases[0].trace


@pytest.mark.slow
def test_a_scenario_without_noise_or_with_an_unknown_component_cannot_be_drawn_again(tmp_path: Path) -> None:
    often = "{{signal: channel.measured, below: 2, seeds: 5, share: 1{vary}}}"
    with pytest.raises(ScenarioError, match="no component is given a `seed`"):
        run(tmp_path, often.format(vary=""), seed="")
    with pytest.raises(ScenarioError, match="source is given no `seed`; known are channel"):
        run(tmp_path, often.format(vary=", vary: [source]"))
