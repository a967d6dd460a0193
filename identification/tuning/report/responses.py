"""What the loops answer to a step of the reference, and to one added to each input of the plant that is commanded."""

from __future__ import annotations

import numpy as np

from identification.tuning.loops.loops import Response
from identification.tuning.report.shown import ShownLoops
from identification.tuning.tuning import Tuning
from orchestrator.display.titles import with_unit
from orchestrator.report import Section
from orchestrator.report.chart import Chart, ChartLine, Curve, Panel


def draw(section: Section, result: Tuning, loops: ShownLoops) -> None:
    """The responses of stable loops."""
    step, units = result.study.step, result.parts.units
    plants, wiring = loops.alone.loops.plants, loops.alone.loops.wiring
    tracked = plants.outputs[wiring.tracked]
    followed = _chart(result, loops, None, ChartLine(step.height, "y", "reference"))
    height = f"{step.height:g} {units.get(tracked, '')}".rstrip()
    section.figure(followed, f"A step of the reference by {height}{loops.remark}")
    for number in dict.fromkeys(path.target for path in wiring.commanded):
        name = plants.inputs[number]
        height = f"{step.disturbance:g} {units.get(name, '')}".rstrip()
        said = f"A step of {height} added to {name}, the reference at rest{loops.remark}"
        section.figure(_chart(result, loops, number, ChartLine(0.0, "y")), said)


def _chart(result: Tuning, loops: ShownLoops, disturbed: int | None, target: ChartLine) -> Chart:
    """All outputs of the plant, and what the controller gives to its inputs."""
    alone = loops.alone.response(disturbed)
    others = None if loops.others is None else loops.others.response(disturbed)
    plants, units = loops.alone.loops.plants, result.parts.units
    panels = []
    for side, names in (("outputs", plants.outputs), ("inputs", plants.inputs)):
        for number, name in enumerate(names):
            tracked = side == "outputs" and number == loops.alone.loops.wiring.tracked
            marks = [target] if tracked else []
            panels.append(_panel(loops, with_unit(name, units.get(name)), side, number, alone, others, marks))
    return Chart(panels, legend=True)


def _panel(
    loops: ShownLoops,
    title: str,
    side: str,
    number: int,
    alone: Response,
    others: Response | None,
    marks: list[ChartLine],
) -> Panel:
    own = getattr(alone, side)[:, :, number]
    style = "line" if side == "outputs" else "steps"
    rows = enumerate(zip(loops.names, own, strict=True))
    curves = [Curve(name, alone.time, row, style, place) for place, (name, row) in rows]  # type: ignore[arg-type]
    bands = [] if others is None else [loops.band(others.time, np.asarray(getattr(others, side)[:, :, number]))]
    return Panel(title, curves, marks, bands)
