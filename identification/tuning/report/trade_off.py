"""What a goal that binds costs: objective and values over its bound."""

from __future__ import annotations

import numpy as np

from identification.tuning.goals.table import MEASURES
from identification.tuning.procedures.procedure import HELD, Trade
from identification.tuning.tuning import Tuning
from orchestrator.display.titles import with_unit
from orchestrator.report import Section
from orchestrator.report.chart import Chart, ChartLine, Curve, Panel
from orchestrator.trace import FloatArray


def draw(section: Section, result: Tuning) -> None:
    """A chart a goal."""
    for trade in result.found.trades:
        goal = result.found.best.goals[trade.goal]
        side = "at least" if goal.lower is not None else "at most"
        said = "what is best where it is asked for less and for more; marked: what the study asks for"
        chart = Chart(_panels(result, trade), x=with_unit(f"{goal.measure} {side}", MEASURES[goal.measure].unit))
        section.figure(chart, f"{goal.measure.capitalize()}: {said}")


def _panels(result: Tuning, trade: Trade) -> list[Panel]:
    held = np.array([best.most_missed <= HELD for best in trade.best])
    rows = {}
    if any(goal.minimised or not goal.hard for goal in trade.best[0].goals):
        rows["objective, all hard goals held"] = np.where(held, [best.objective for best in trade.best], np.nan)
    if not held.all():
        missed = [100 * max(best.most_missed, 0.0) if best.stable else np.nan for best in trade.best]
        rows["missed of the goal missed most [%]"] = np.array(missed)
    for name in result.found.starts:
        unit = result.parts.interface.ports[name].unit
        rows[with_unit(name, unit)] = np.array([best.values[name] for best in trade.best])
    mark = ChartLine(float(trade.asked[len(trade.asked) // 2]), "x")
    return [_panel(title, trade.asked, values, mark) for title, values in rows.items()]


def _panel(title: str, asked: FloatArray, values: FloatArray, mark: ChartLine) -> Panel:
    return Panel(title, [Curve(title, asked, values)], [mark])
