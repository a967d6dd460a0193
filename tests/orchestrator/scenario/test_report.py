"""The report of a run shows what was asked of it, what drove it, and from what it ran."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.files import sha256
from orchestrator.formats import write
from orchestrator.report import Chart, ChartLine
from orchestrator.report.checks import Checks
from orchestrator.report.content import Content, DataTable, DrawnFigure, Folded
from orchestrator.report.document import Report
from orchestrator.report.wiring import WiringDiagram
from orchestrator.scenario.report import OPEN_SIGNALS, report
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.trace import Trace
from tests.support.tools.reports import EVIL, Page

SCENARIO = """
title: A swing
components:
  motor: {model: dc_motor, step: 0.02}
  hand: {model: pendulum, parameters: {angle_start: 0.5}}
connections: [motor.torque -> hand.torque, hand.speed -> motor.speed]
stimuli: {motor.voltage: {file: voltage.csv, signal: voltage}}
run: {stop: 1, step: 0.01}
expect:
  - {signal: hand.angle, after: 0.5, below: 2.5}
  - {signal: hand.speed, near: 0, within: 40}
  - {signal: hand.energy, reference: {file: energy.csv, signal: energy}, within: 5}
"""


def ran(folder: Path, text: str = SCENARIO) -> ScenarioResult:
    time = np.linspace(0, 1, 101)
    write(Trace(time, {"voltage": 0.01 * np.sin(9 * time)}, {"voltage": "V"}), folder / "voltage.csv")
    write(Trace(time, {"energy": 0.0 * time}, {"energy": "J"}), folder / "energy.csv")
    (folder / "swing.yaml").write_text(text)
    return run_scenario(folder / "swing.yaml")


def contents(page: Report, heading: str) -> list[Content]:
    [section] = [section for section in page.sections if section.heading == heading]
    return section.content


def charts(page: Report) -> list[Chart]:
    drawn = [piece.drawing for piece in contents(page, "Traces") if isinstance(piece, DrawnFigure)]
    return [one for one in drawn if isinstance(one, Chart)]


def test_each_expectation_has_its_verdict_its_figure_and_its_margin(tmp_path: Path) -> None:
    result = ran(tmp_path, SCENARIO.replace("within: 5", "within: 0"))
    [checks] = [piece for piece in contents(report(result), "Expectations") if isinstance(piece, Checks)]
    largest = float(result.cases[0].trace.between(0.5, 1)["hand.angle"].max())
    first, second, third = checks.rows
    assert (first.kind, first.asked) == ("ok", "hand.angle stays below 2.5 rad after 0.5 s")
    assert first.found == f"largest {largest:.6g} rad"
    assert first.margin == f"{float(f'{2.5 - largest:.3g}'):.5g} rad".replace("-", "−")
    assert second.kind == "ok" and str(second.margin).endswith(" rad/s")
    assert third.kind == "error" and str(third.margin).startswith("−") and str(third.margin).endswith(" J")


def test_the_parts_of_an_expectation_stand_below_it_and_warnings_are_none_of_its_failures(tmp_path: Path) -> None:
    text = (
        SCENARIO
        + """  - any:
      - {signal: hand.angle, below: -9}
      - {signal: hand.angle, below: 9}
  - warn: {signal: hand.angle, below: -9}
"""
    )
    [checks] = [piece for piece in contents(report(ran(tmp_path, text)), "Expectations") if isinstance(piece, Checks)]
    rows = [(row.depth, row.kind) for row in checks.rows[3:]]
    assert rows[:3] == [(0, "ok"), (1, "error"), (1, "ok")]
    assert rows[3] == (0, "warning")


def test_ranges_and_funnels_are_drawn_as_tubes(tmp_path: Path) -> None:
    expect = """
  - {signal: hand.angle, range: [{to: 0.5, above: -9, below: [9, 5]}, {above: -5, below: 5}]}
  - {signal: hand.energy, reference: {file: energy.csv, signal: energy}, funnel: {value: 5}}
"""
    page = report(ran(tmp_path, SCENARIO.split("expect:", maxsplit=1)[0] + "expect:" + expect))
    panels = {panel.title.split()[0]: panel for panel in charts(page)[0].panels}
    [angle], [energy] = (panels[f"hand.{name}"].bands for name in ("angle", "energy"))
    assert np.asarray(angle.upper)[0] == 9 and np.asarray(angle.lower)[-1] == -5
    assert np.all(np.asarray(energy.upper) == 5)


def test_limits_tubes_and_references_are_drawn_with_the_signals_that_they_judge(tmp_path: Path) -> None:
    [chart] = charts(report(ran(tmp_path)))
    panels = {panel.title: panel for panel in chart.panels}
    assert list(panels)[:3] == ["hand.angle [rad]", "hand.speed [rad/s]", "hand.energy [J]"]
    [limit] = panels["hand.angle [rad]"].marks
    assert isinstance(limit, ChartLine)
    assert (limit.axis, limit.value, limit.label, limit.span) == ("y", 2.5, "below 2.5", (0.5, 1.0))
    for title, width in (("hand.speed [rad/s]", 40), ("hand.energy [J]", 5)):
        [tube] = panels[title].bands
        assert np.all(np.asarray(tube.lower) == -width) and np.all(np.asarray(tube.upper) == width)
        _, reference = panels[title].curves
        assert reference.tone == "reference" and not np.any(np.asarray(reference.y))


def test_every_sample_is_drawn_and_what_drove_the_system_is_below(tmp_path: Path) -> None:
    result = ran(tmp_path)
    [chart] = charts(report(result))
    for panel in chart.panels[:-1]:
        name = panel.title.split(" [")[0]
        assert np.array_equal(np.asarray(panel.curves[0].y), result.cases[0].trace[name])
    driven = chart.panels[-1]
    assert (driven.title, driven.curves[0].label) == ("motor.voltage [V]", "input")
    assert np.allclose(driven.curves[0].y, 0.01 * np.sin(9 * np.linspace(0, 1, 101)))


def test_what_goes_on_longer_than_its_scenario_is_drawn_with_the_last_value_of_what_drove_it(tmp_path: Path) -> None:
    result = ran(tmp_path)
    [case] = result.cases
    assert case.result is not None
    longer = Trace(2 * case.trace.time, case.trace.signals, case.trace.units)
    result = replace(result, cases=(replace(case, result=replace(case.result, trace=longer)),))
    [chart] = charts(report(result))
    driven = np.asarray(chart.panels[-1].curves[0].y)
    assert np.allclose(driven[longer.time >= 1], 0.01 * np.sin(9))


def test_signals_beyond_the_first_ones_are_a_click_away_and_none_is_lost(tmp_path: Path) -> None:
    many = "\n".join(f"  p{number}: {{model: pendulum}}" for number in range(4))
    text = f"title: Many\ncomponents:\n{many}\nrun: {{stop: 0.1, step: 0.01}}\n"
    result = ran(tmp_path, text)
    page = report(result)
    [first] = charts(page)
    [folded] = [piece for piece in contents(page, "Traces") if isinstance(piece, Folded)]
    [rest] = [piece.drawing for piece in folded.content if isinstance(piece, DrawnFigure)]
    assert isinstance(rest, Chart)
    assert len(first.panels) == OPEN_SIGNALS
    titles = [panel.title.split(" [")[0] for panel in (*first.panels, *rest.panels)]
    assert sorted(titles) == sorted(result.cases[0].trace.names)


def test_the_wiring_has_steps_units_and_what_drives_it(tmp_path: Path) -> None:
    pieces = contents(report(ran(tmp_path)), "System")
    [wiring] = [
        piece.drawing for piece in pieces if isinstance(piece, DrawnFigure) and isinstance(piece.drawing, WiringDiagram)
    ]
    boxes = {box.name: box for box in wiring.boxes}
    assert (boxes["motor"].about, boxes["motor"].rate) == ("dc_motor", "every 0.02 s")
    assert boxes["hand"].rate == "every 0.01 s"
    assert boxes["motor"].outputs["torque"] == "torque [N.m]"
    assert boxes["→ motor.voltage"].outside and boxes["→ motor.voltage"].about == "voltage.csv"
    assert {(wire.source, wire.target) for wire in wiring.wires} == {
        (("→ motor.voltage", "y"), ("motor", "voltage")),
        (("motor", "torque"), ("hand", "torque")),
        (("hand", "speed"), ("motor", "speed")),
    }


def test_parameters_say_who_set_them(tmp_path: Path) -> None:
    ran(tmp_path)
    page = report(run_scenario(tmp_path / "swing.yaml", {"hand.inertia": 0.002}))
    pieces = contents(page, "System")
    [table] = [piece for piece in pieces if isinstance(piece, DataTable)]
    rows = {str(row[0]): row[1:4] for row in table.rows}
    assert rows["hand.angle_start"] == ["0.5", "rad", "file"]
    assert rows["hand.inertia"] == ["0.002", "kg.m2", "--set"]
    [folded] = [piece for piece in pieces if isinstance(piece, Folded)]
    [others] = [piece for piece in folded.content if isinstance(piece, DataTable)]
    assert {row[3] for row in others.rows} == {"FMU"} and "motor.torque_gain" in {row[0] for row in others.rows}


def test_what_ran_is_told_by_its_hash(tmp_path: Path) -> None:
    result = ran(tmp_path)
    [table, *_] = [piece for piece in contents(report(result), "Provenance") if isinstance(piece, DataTable)]
    rows = {str(row[0]): row[1:] for row in table.rows}
    assert rows["scenario"] == ["swing.yaml", sha256(tmp_path / "swing.yaml")]
    assert rows["motor"] == ["model dc_motor", result.hashes["motor"]] and len(result.hashes["motor"]) == 64
    assert rows["stimulus motor.voltage"] == ["voltage.csv", sha256(tmp_path / "voltage.csv")]
    assert rows["reference"] == ["energy.csv", sha256(tmp_path / "energy.csv")]


@pytest.mark.parametrize("name", ["<b>", "a & b", "</script><script>alert(1)</script>", 'quo"te', EVIL])
def test_names_from_files_are_no_markup(tmp_path: Path, name: str) -> None:
    plain, hostile = (
        Page(report(ran(tmp_path, f"{SCENARIO}cases: [{{name: {json.dumps(word)}}}, {{name: other}}]\n")).render())
        for word in ("plain", name)
    )
    assert hostile.tags == plain.tags
    assert hostile.words.count(name) == plain.words.count("plain") >= 3


def test_what_is_asked_after_the_end_of_a_run_is_not_drawn_and_stops_no_report(tmp_path: Path) -> None:
    text = SCENARIO.replace("near: 0, within: 40", "near: 0, within: 40, after: 0.5")
    result = ran(tmp_path, text.replace("reference: {", "after: 0.5, reference: {"))
    [case] = result.cases
    assert case.result is not None
    early = replace(result, cases=(replace(case, result=replace(case.result, trace=case.trace.between(0, 0.2))),))
    marked = [[(len(panel.marks), len(panel.bands)) for panel in chart.panels] for chart in charts(report(result))]
    bare = [[(len(panel.marks), len(panel.bands)) for panel in chart.panels] for chart in charts(report(early))]
    assert marked[0][:3] == [(1, 0), (0, 1), (0, 1)] and bare[0][:3] == [(0, 0)] * 3
    assert report(early).render()
