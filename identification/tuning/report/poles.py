"""Closed-loop poles from plant to plant: root contours."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from identification.tuning.goals.poles import FAST
from identification.tuning.loops.loops import Loops
from identification.tuning.report.shown import ShownLoops
from identification.tuning.tuning import Tuning
from orchestrator.report import Section
from orchestrator.report.chart import HEIGHT, Chart, ChartLine, Curve, Panel
from orchestrator.trace import ComplexArray


def draw(section: Section, result: Tuning, every: ShownLoops) -> None:
    """Where the poles lie, as those of a continuous system, and how they move from plant to plant."""
    loops = every.alone.loops
    step, curves = loops.plants.step, []
    if every.others is not None:
        spread = continuous(every.others.loops.poles.ravel(), step)
        curves.append(Curve(every.word, spread.real, spread.imag, "dots", tone="measured"))
    if len(every.names) > 1:
        curves.append(_contours(result, loops))
    for number, (name, poles) in enumerate(zip(every.names, continuous(loops.poles, step), strict=True)):
        curves.append(Curve(name, poles.real, poles.imag, "crosses", number))
    panel = Panel("imaginary part [rad/s]", curves, [ChartLine(0.0, "x")])
    chart = Chart([panel], x="real part [1/s]", height=3 * HEIGHT, legend=True)
    said = "Closed-loop poles s = ln(z) / T, stable on the left; those that are gone within a sample are left out"
    section.figure(chart, said + every.remark)


def _contours(result: Tuning, loops: Loops) -> Curve:
    """On which ways the poles go: over the parameter in which the plants differ, or else from plant to plant."""
    word = "from plant to plant"
    if result.parts.between is not None:
        word, plants = result.parts.between
        loops = result.problem.on(plants).trial(result.found.best.values).loops
    paths = continuous(followed(loops.poles), loops.plants.step)
    ended = np.pad(paths.T, ((0, 0), (0, 1)), constant_values=np.nan).ravel()
    return Curve(word, ended.real, ended.imag, tone="reference")


def continuous(poles: ComplexArray, step: float) -> ComplexArray:
    """Poles of the z-plane as those of a continuous system [1/s]; nan for what is gone within a sample."""
    lasting = np.isfinite(poles) & (np.abs(poles) > FAST)
    kept = np.where(lasting, poles, 1.0)
    return np.where(lasting, np.log(kept) / step, complex(np.nan, np.nan))


def followed(poles: ComplexArray) -> ComplexArray:
    """(N, n) the poles of each row in the order of those of the row before that they are nearest to, all together."""
    ordered = [poles[0]]
    for row in poles[1:]:
        away = np.nan_to_num(np.abs(ordered[-1][:, None] - row[None, :]), nan=1e300, posinf=1e300)
        ordered.append(row[linear_sum_assignment(away)[1]])
    return np.array(ordered)
