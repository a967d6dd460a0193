"""What a tuning's report draws: the loops as python-control has them, the disk that they touch, poles on their way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.tuning.loops.margins import disk_margins
from identification.tuning.report.frequency import disk, lines
from identification.tuning.report.page import report
from identification.tuning.report.poles import continuous, followed
from identification.tuning.schema import TuneBlock
from identification.tuning.tuning import Tuning, tune
from orchestrator.report.chart import Chart, Panel
from orchestrator.report.content import DrawnFigure
from orchestrator.yaml_file import load
from tests.support.identification.tuned_loops import loops, plant
from tests.support.identification.tuning_study import driven, study, write
from tests.support.tools.browser import browsing, opened


def tuned(folder: Path, document: dict[str, Any]) -> Tuning:
    return tune(load(write(folder, document), TuneBlock).study(folder))


def charts(result: Tuning) -> dict[str, Chart]:
    """First word of a caption -> its chart."""
    found = {}
    for section in report(result).sections:
        for piece in section.content:
            if isinstance(piece, DrawnFigure) and isinstance(piece.drawing, Chart):
                found[piece.caption.split(":")[0].split(";")[0]] = piece.drawing
    return found


def test_a_bode_chart_is_that_of_python_control() -> None:
    model, gain = plant(3), 0.7
    drawn = lines(loops(model, gain).opened())
    system = gain * control.ss(model.a, model.b, model.c, model.d, model.step)
    known = control.frequency_response(system, drawn.omega[0])
    assert drawn.decibel[0] == pytest.approx(20 * np.log10(known.magnitude), abs=1e-6)
    assert np.exp(1j * np.deg2rad(drawn.phase[0])) == pytest.approx(np.exp(1j * known.phase), abs=1e-6)
    assert np.abs(np.diff(drawn.phase[0])).max() < 180


@given(st.floats(0.05, 1.9))
def test_a_disk_is_where_the_balanced_sensitivity_is_one_over_alpha(alpha: float) -> None:
    sensitivity = 1 / (1 + disk(alpha))
    assert np.abs(sensitivity - 0.5) == pytest.approx(np.full(181, 1 / alpha), rel=1e-9)


def test_a_loop_touches_its_disk_and_does_not_enter_it() -> None:
    loop = loops(plant(3), 0.7).opened()
    circle = disk(float(disk_margins(loop)[0]))
    middle = circle.real.max() / 2 + circle.real.min() / 2
    radius = circle.real.max() - middle
    away = np.abs(loop.values[0] - middle) / radius
    assert away.min() == pytest.approx(1.0, abs=2e-3)
    assert away.min() > 1 - 1e-6


def test_poles_are_followed_whatever_the_order_they_come_in() -> None:
    rng = np.random.default_rng(2)
    start = np.array([0.9 + 0.1j, 0.9 - 0.1j, 0.2, -0.5])
    rows = np.array([rng.permutation(start + 0.01 * k) for k in range(8)])
    for path in followed(rows).T:
        assert np.abs(np.diff(path)) == pytest.approx(np.full(7, 0.01))


def test_what_is_gone_within_a_sample_has_no_continuous_pole() -> None:
    found = continuous(np.array([np.exp(-0.2 + 0.3j), 0.0, np.inf]), 0.1)
    assert found[0] == pytest.approx(-2 + 3j)
    assert np.isnan(found[1:]).all()


@pytest.mark.slow
def test_a_report_draws_every_plant_and_all_draws(tmp_path: Path) -> None:
    spread = driven(tmp_path, spread={"load.inertia": 0.01}) | {"draws": {"count": 20, "share": 0.9}}
    result = tuned(tmp_path, spread)
    found = charts(result)
    assert [name.split()[0] for name in found] == ["Phase", "Bode", "Nyquist", "Nichols", "Closed-loop", "A", "A"]
    assert result.unseen is not None
    followed_by = result.problem.on(result.parts.unseen).trial(result.found.best.values).followed  # type: ignore[arg-type]
    panel: Panel = found["A step of the reference by 1 V"].panels[0]
    [band] = panel.bands
    assert np.asarray(band.lower) == pytest.approx(followed_by.outputs[:, :, 0].min(axis=0))
    assert np.asarray(band.upper) == pytest.approx(followed_by.outputs[:, :, 0].max(axis=0))
    disturbed = found["A step of 1 V added to u, the reference at rest"].panels[0]
    [curve] = disturbed.curves
    assert np.asarray(curve.y)[-1] == pytest.approx(1 / result.found.best.values["kp"], rel=0.05)


@pytest.mark.slow
def test_contours_go_over_the_parameter_in_which_systems_differ(tmp_path: Path) -> None:
    """At the ends they are where the plants' poles are, and in the middle where those of a plant between them are."""
    document = driven(tmp_path)
    [load_plant] = document["plants"].values()
    payloads = (0.05, 0.15, 0.1)
    for count in (2, 3):
        document["plants"] = {f"{value}": load_plant | {"set": {"load.inertia": value}} for value in payloads[:count]}
        result = tuned(tmp_path, document)
        assert result.parts.between is not None
        name, plants = result.parts.between
        assert name == "load.inertia"
        between = result.problem.on(plants).trial(result.found.best.values).loops.poles
        alone = result.problem.trial(result.found.best.values).loops.poles
        for place, number in ((0, 0), (-1, 1), (20, 2))[:count]:
            assert np.sort_complex(between[place]) == pytest.approx(np.sort_complex(alone[number]))
    drawn = charts(result)["Closed-loop poles s = ln(z) / T, stable on the left"].panels[0]
    curve = drawn.curves[0]
    assert curve.label == "load.inertia"


@pytest.mark.slow
def test_a_trade_off_has_the_optimum_under_each_bound(tmp_path: Path) -> None:
    """The faster the loop the less of its phase margin is left: each optimum has the margin that is asked for there."""
    result = tuned(tmp_path, study())
    [trade] = result.found.trades
    assert trade.asked == pytest.approx([42, 51, 60, 69, 78])
    assert [best.figures[0].min() for best in trade.best] == pytest.approx(trade.asked, abs=1e-3)
    assert np.all(np.diff([best.objective for best in trade.best]) > 0)
    chart = charts(result)["Phase margin"]
    assert [panel.title for panel in chart.panels] == ["objective, all hard goals held", "kp"]


def test_a_trade_off_of_what_cannot_be_had_tells_what_is_missed(tmp_path: Path) -> None:
    goals = [{"measure": "phase margin", "at_least": 80}, {"measure": "decay rate", "at_least": 4}]
    result = tuned(tmp_path, study(goals=goals, minimise=None))
    assert {trade.goal for trade in result.found.trades} == {0, 1}
    for trade in result.found.trades:
        assert np.all(np.diff([best.most_missed for best in trade.best]) > -1e-6)
    assert charts(result)["Decay rate"].panels[0].title == "missed of the goal missed most [%]"


def test_unstable_plants_are_told_and_left_out_of_the_responses(tmp_path: Path) -> None:
    design = {"unknowns": {"kp": {"start": 150, "min": 140, "max": 160}}}
    found = charts(tuned(tmp_path, study(design=design)))
    followed_ones = next(chart for name, chart in found.items() if name.startswith("A step of the reference"))
    assert [curve.label for curve in followed_ones.panels[0].curves] == ["heavy"]


@pytest.mark.slow
@pytest.mark.needs("browser", "chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_opens_in_a_browser_without_a_complaint(tmp_path: Path, scheme: Any) -> None:
    spread = driven(tmp_path, spread={"load.inertia": 0.01}) | {"draws": {"count": 20, "share": 0.9}}
    file = report(tuned(tmp_path, spread)).write(tmp_path / "report.html")
    with browsing() as browser, opened(browser, file, scheme) as seen:
        count = seen.page.locator(".chart:visible").count()
        views = [seen.view(number) for number in range(count)]
        assert count == 7
        assert all(np.isfinite(curve[1:]).all() for view in views for panel in view["panels"] for curve in panel)
        assert (seen.complaints, seen.requests) == ([], [])
