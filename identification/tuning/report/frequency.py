"""Opened loops over frequency: Bode, Nyquist and Nichols charts, with the disk of the balanced disk margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.tuning.goals.goal import Goal
from identification.tuning.goals.margins import MEASURES
from identification.tuning.loops.margins import disk_margins
from identification.tuning.loops.open_loop import OpenLoop
from identification.tuning.loops.wiring import Path
from identification.tuning.report.shown import ShownLoops
from identification.tuning.tuning import Tuning
from orchestrator.display.table import Cell
from orchestrator.report import Section
from orchestrator.report.chart import HEIGHT, Chart, ChartLine, ChartPoint, Curve, Panel
from orchestrator.trace import ComplexArray, FloatArray

PLANE = 50  # of loops that are not drawn one by one, that are drawn in planes: those nearest to -1
DECADES = 1e-4  # of half the sampling frequency, from where on a chart shows it at first
AROUND = (-3.0, 2.0)  # real parts that a Nyquist chart shows at first
LEVELS = 40.0  # decibels up and down that a Nichols chart shows
WIDEST = 1.99  # alpha, above which a disk is hardly a disk any more


def draw(section: Section, result: Tuning, every: ShownLoops) -> None:
    """Charts and margins of the loops at each place where a goal opens them."""
    loops = every.alone.loops
    goals = [goal for goal in result.found.best.goals if goal.measure in MEASURES]
    places = list(dict.fromkeys(goal.opened or loops.wiring.opened for goal in goals)) or [loops.wiring.opened]
    for place in places:
        if len(places) > 1:
            section.subheading(f"Opened at {place.name}")
        _charts(section, every, place, [goal for goal in goals if (goal.opened or loops.wiring.opened) == place])
        if every.alone.loops.stable.all():
            _margins(section, every, place)


@dataclass(frozen=True, eq=False)
class OpenedLoops:
    """Opened loops side by side.

    Attributes:
        omega: (N, F) [rad/s].
        value: (N, F).
        phase: (N, F) [deg], without jumps.
    """

    omega: FloatArray
    value: ComplexArray
    phase: FloatArray

    @property
    def decibel(self) -> FloatArray:
        """(N, F)."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.value)))

    def only(self, numbers: np.ndarray) -> OpenedLoops:
        """Some of them."""
        return OpenedLoops(self.omega[numbers], self.value[numbers], self.phase[numbers])

    def on(self, values: FloatArray, omega: FloatArray) -> FloatArray:
        """(N, K) values (N, F) at frequencies (K,) between theirs."""
        return np.array([np.interp(np.log(omega), np.log(w), row) for w, row in zip(self.omega, values, strict=True)])


def lines(loop: OpenLoop, first: float | None = None) -> OpenedLoops:
    """The loops, their phases beginning near `first` [deg], or between -270 and 90."""
    phase = np.rad2deg(np.unwrap(np.angle(loop.values), axis=1))
    near = np.full(len(phase), -90.0)
    if first is not None:
        near[:] = first
    elif len(phase):
        near[1:] = phase[0, 0] + 360 * np.round((-90 - phase[0, 0]) / 360)
    phase += 360 * np.round((near - phase[:, 0]) / 360)[:, None]
    return OpenedLoops(loop.frequencies, loop.values, phase)


def disk(alpha: float) -> ComplexArray:
    """(K,) the circle that L stays out of with a disk margin alpha (Seiler, Packard, Gahinet 2020)."""
    left, right = -(2 + alpha) / (2 - alpha), -(2 - alpha) / (2 + alpha)
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 181))
    return np.asarray((left + right) / 2 + (right - left) / 2 * turn)


def _charts(section: Section, every: ShownLoops, place: Path, goals: Sequence[Goal]) -> None:
    loop = every.alone.loops.opened(place)
    alone = lines(loop)
    others = None if every.others is None else lines(every.others.loops.opened(place), float(alone.phase[0, 0]))
    section.figure(_bode(every, alone, others), f"Bode: the loop opened at {place.name}{every.remark}")
    nearest = None if others is None else _nearest(others)
    alpha = float(disk_margins(loop).min()) if every.alone.loops.stable.all() else np.nan
    circle = disk(alpha) if alpha < WIDEST else None
    said = "" if circle is None else f"; the disk of alpha {alpha:.3g}, which no plant enters"
    if nearest is not None:
        said += f"; of {every.word} the {len(nearest.omega)} that come nearest to -1"
    section.figure(_nyquist(every, alone, nearest, circle), f"Nyquist{said}")
    section.figure(_nichols(every, alone, nearest, circle, goals), f"Nichols{said}; crossing bars are what is asked")


def _nearest(others: OpenedLoops) -> OpenedLoops:
    away = np.abs(1 + others.value).min(axis=1)
    return others.only(np.argsort(away, kind="stable")[:PLANE])


def _bode(every: ShownLoops, alone: OpenedLoops, others: OpenedLoops | None) -> Chart:
    panels = []
    grid = np.unique(alone.omega)
    for title, level, own, its in (
        ("magnitude [dB]", 0.0, alone.decibel, None if others is None else others.decibel),
        ("phase [deg]", -180.0, alone.phase, None if others is None else others.phase),
    ):
        rows = enumerate(zip(every.names, alone.omega, own, strict=True))
        curves = [Curve(name, omega, row, colour=number) for number, (name, omega, row) in rows]
        bands = [] if others is None or its is None else [every.band(grid, others.on(its, grid))]
        panels.append(Panel(title, curves, [ChartLine(level, "y")], bands))
    end = float(alone.omega.max())
    return Chart(panels, x="frequency [rad/s]", log_x=True, x_range=(DECADES * end, end), legend=True)


def _nyquist(every: ShownLoops, alone: OpenedLoops, others: OpenedLoops | None, circle: ComplexArray | None) -> Chart:
    curves = [] if others is None else [_bundle(every.word, others.value.real, others.value.imag)]
    if circle is not None:
        curves.append(Curve("disk", circle.real, circle.imag, tone="reference"))
    rows = enumerate(zip(every.names, alone.value, strict=True))
    curves += [Curve(name, value.real, value.imag, colour=number) for number, (name, value) in rows]
    panel = Panel("imaginary part", curves, [ChartPoint(-1.0, 0.0, "-1")])
    return Chart([panel], x="real part", equal=True, height=3 * HEIGHT, x_range=AROUND, legend=True)


def _nichols(
    every: ShownLoops,
    alone: OpenedLoops,
    others: OpenedLoops | None,
    circle: ComplexArray | None,
    goals: Sequence[Goal],
) -> Chart:
    curves = [] if others is None else [_bundle(every.word, others.phase, others.decibel)]
    if circle is not None:
        turned = np.rad2deg(np.mod(np.angle(circle), 2 * np.pi)) - 360
        curves.append(Curve("disk", turned, 20 * np.log10(np.abs(circle)), tone="reference"))
    rows = enumerate(zip(every.names, alone.phase, alone.decibel, strict=True))
    curves += [Curve(name, phase, level, colour=number) for number, (name, phase, level) in rows]
    marks: list[ChartLine | ChartPoint] = [ChartPoint(-180.0, 0.0, "-1")]
    for goal in goals:
        asked = goal.lower or 0.0
        if goal.measure == "gain margin":
            marks.append(ChartLine(-180.0, "x", "", (-asked, asked)))
        if goal.measure == "phase margin":
            marks.append(ChartLine(0.0, "y", "", (-180.0 - asked, -180.0 + asked)))
    panel = Panel("magnitude [dB]", curves, marks, range=(-LEVELS, LEVELS))
    return Chart([panel], x="phase [deg]", height=3 * HEIGHT, x_range=(-360.0, 0.0), legend=True)


def _bundle(word: str, x: FloatArray, y: FloatArray) -> Curve:
    """Curves (N, F) as one, with gaps between them."""
    across, up = (np.pad(values, ((0, 0), (0, 1)), constant_values=np.nan).ravel() for values in (x, y))
    return Curve(word, across, up, tone="measured")


def _margins(section: Section, every: ShownLoops, place: Path) -> None:
    goals = [Goal(measure, opened=place) for measure in MEASURES]
    found = [MEASURES[goal.measure].figures(every.alone, goal) for goal in goals]
    headers = ["plant", *(f"{goal.measure} [{MEASURES[goal.measure].unit}]" for goal in goals)]
    rows: list[list[Cell]] = [
        [name, *map(float, row)] for name, row in zip(every.names, np.transpose(found), strict=True)
    ]
    section.table(headers, rows, caption=f"Margins at {place.name}")
