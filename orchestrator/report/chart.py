"""Charts: curves in windows above each other that a reader zooms down to single samples.

A chart is plain data: panels with curves, bands and marks over one horizontal axis. A report draws it:

    gain = Panel("magnitude [dB]", [Curve("loop", omega, 20 * np.log10(abs(response)))], [ChartLine(0.0, "y")])
    phase = Panel("phase [deg]", [Curve("loop", omega, phase)], [ChartLine(-180.0, "y")])
    section.figure(Chart([gain, phase], x="frequency [rad/s]", log_x=True), "Bode plot of the open loop")

    nyquist = Panel("imaginary part", [Curve("loop", response.real, response.imag)], [ChartPoint(-1.0, 0.0, "-1")])
    section.figure(Chart([nyquist], x="real part", equal=True))

    contours = [Curve(f"pole {k}", path.real, path.imag, colour=k) for k, path in enumerate(paths)]
    ends = Curve("nominal", poles.real, poles.imag, style="crosses", colour=0)
    section.figure(Chart([Panel("imaginary part", [*contours, ends])], x="real part", equal=True))

Curves may run to and fro in x, as these do; those that increase in x (over time, over frequency) may hold millions of
samples, of which no view misses a peak. Samples that are not finite leave gaps. Labels are plain text, to be escaped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, NotRequired, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.display.table import text
from orchestrator.report.columns import STRETCH, Columns
from orchestrator.trace import FloatArray

Style = Literal["line", "steps", "dots", "crosses", "circles", "stems"]
Tone = Literal["data", "measured", "reference"]
HEIGHT = 170  # of a panel [px]
AXIS = 30  # of the horizontal axis [px]; chart.js has the same number
COLOURS = 6  # that are told apart, also by dashes; chart.js and style.css have as many
ONE_PLACE = 1e-5  # of its amount, by which signs at one place of the horizontal axis may differ
MOST_SAID = 8  # panels, and curves of each, whose extremes are told to who cannot see them
THINNED = f"Drawn by the extremes of every {STRETCH} samples, as there are too many for a page."


@dataclass(frozen=True, eq=False)
class Curve:
    """Points (K,) and how they are drawn.

    Attributes:
        label: its name in the legend; curves of one label are shown and hidden together.
        style: joined by lines; by steps (each value holds until the next); or marked one by one, "stems" from zero on.
        colour: number of its colour and dash, from 0.
        tone: "measured" is drawn broad and pale below the others, "reference" dashed and neutral.
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    style: Style = "line"
    colour: int = 0
    tone: Tone = "data"


@dataclass(frozen=True, eq=False)
class Band:
    """The area between lower (K,) and upper (K,) over x (K,), such as a tube that a curve may not leave."""

    label: str
    x: ArrayLike
    lower: ArrayLike
    upper: ArrayLike


@dataclass(frozen=True)
class ChartLine:
    """A straight line at a value of an axis, with a word at it.

    Attributes:
        span: from where to where on the other axis; None is all of it.
        wrong: whether it shows what is not as it should be.
    """

    value: float
    axis: Literal["x", "y"]
    label: str = ""
    span: tuple[float, float] | None = None
    wrong: bool = False


@dataclass(frozen=True)
class ChartPoint:
    """A single point with a word at it.

    Attributes:
        wrong: whether it shows what is not as it should be.
    """

    x: float
    y: float
    label: str = ""
    wrong: bool = False


@dataclass(frozen=True)
class Panel:
    """A window: its vertical axis' title with the unit, and what is in it.

    Attributes:
        log: whether the vertical axis is logarithmic.
        range: what it shows at first and when all is shown; None fits it to what is in view.
    """

    title: str
    curves: Sequence[Curve] = ()
    marks: Sequence[ChartLine | ChartPoint] = ()
    bands: Sequence[Band] = ()
    log: bool = False
    range: tuple[float, float] | None = None


Ends = tuple[float, float]


class CurveDocument(TypedDict):
    """A curve as chart.js draws it, by the numbers of its columns."""

    label: str
    x: int
    y: int
    rising: bool
    style: Style
    colour: int
    tone: Tone


class BandDocument(TypedDict):
    """A band as chart.js draws it, by the numbers of its columns."""

    label: str
    x: int
    lower: int
    upper: int


class MarkDocument(TypedDict):
    """A line, which has one place and a span, or a point, which has both."""

    label: str
    wrong: bool
    x: NotRequired[float]
    y: NotRequired[float]
    span: NotRequired[Ends | None]


class PanelDocument(TypedDict):
    """A panel as chart.js draws it."""

    title: str
    log: bool
    range: Ends | None
    curves: list[CurveDocument]
    bands: list[BandDocument]
    marks: list[MarkDocument]


class ChartDocument(TypedDict):
    """A chart as chart.js draws it."""

    x: str
    logX: bool
    equal: bool
    height: int
    range: Ends
    upright: Ends | None
    legend: bool
    panels: list[PanelDocument]


@dataclass(frozen=True)
class Chart:
    """Panels above each other over one horizontal axis.

    Attributes:
        x: title of the horizontal axis, with its unit.
        log_x: whether that is logarithmic; what is not positive is then left out.
        equal: whether a unit is as long on both axes, as in a complex plane.
        height: of a panel [px].
        x_range: what is shown at first; None shows everything. A plane then has 0, or the middle of its panel's range,
            in its middle.
        legend: whether it has one; None is where it tells more than the titles of the panels do.
    """

    panels: Sequence[Panel]
    x: str = "time [s]"
    log_x: bool = False
    equal: bool = False
    height: int = HEIGHT
    x_range: tuple[float, float] | None = None
    legend: bool | None = None

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        """Its element, with its numbers added to the columns of the page."""
        before = len(columns.columns)
        told = _json(self._document(columns))
        thinned = any(column.thinned for column in columns.columns[before:])
        note = f"<p class='note'>{THINNED}</p>" if thinned else ""
        shown = self._named() if self.legend is None else self.legend
        legend = f'<div class="legend">{"".join(self._keys())}</div>' if shown else ""
        height = self.height * len(self.panels) + AXIS
        return (
            f'<div class="chart" id="chart-{key}"><script type="application/json">{told}</script>{legend}'
            f'<div class="frame" style="min-height:{height}px">'
            f'<canvas tabindex="0" role="img" aria-label="{self._said(caption)}"></canvas>'
            '<div class="hair"></div><div class="box"></div><output class="readout"></output></div></div>' + note
        )

    def _keys(self) -> Iterator[str]:
        """What the legend says: each label once, with what it looks like."""
        seen = set()
        for panel in self.panels:
            drawings: list[Curve | Band] = [*panel.curves, *panel.bands]
            for drawn in drawings:
                if drawn.label not in seen:
                    seen.add(drawn.label)
                    yield f'<button type="button" aria-pressed="true">{key_of(drawn)}{escape(drawn.label)}</button>'

    def _said(self, caption: str) -> str:
        """What who cannot see it is told: what is in it, and the values between which it lies."""
        whole = [f"{caption or 'Chart'}: {', '.join(panel.title for panel in self.panels)} over {self.x}."]
        for panel in self.panels[:MOST_SAID]:
            for curve in panel.curves[:MOST_SAID]:
                y = np.asarray(curve.y, dtype=float)
                y = y[np.isfinite(y)]
                if len(y):
                    whole.append(f"{panel.title}, {curve.label}: {text(float(y.min()))} to {text(float(y.max()))}.")
        return escape(" ".join(whole))

    def _document(self, columns: Columns) -> ChartDocument:
        return {
            "x": self.x,
            "logX": self.log_x,
            "equal": self.equal,
            "height": self.height,
            "range": self.x_range or self._extent(),
            "upright": self._upright() if self.equal else None,
            "legend": self._named() if self.legend is None else self.legend,
            "panels": [_panel(panel, columns) for panel in self.panels],
        }

    def _named(self) -> bool:
        """Whether a legend tells more than the titles of the panels do."""
        return any(len(panel.curves) + len(panel.bands) > 1 for panel in self.panels)

    def _extent(self) -> tuple[float, float]:
        """All of the horizontal axis that holds something, a little more in a plane and around signs."""
        low, high = _ends(self.panels, "x", self.log_x)
        signs = any(curve.style not in ("line", "steps") for panel in self.panels for curve in panel.curves)
        if high - low <= (ONE_PLACE * max(abs(low), abs(high)) if signs else 0.0):
            slack = max(abs(low), 1.0) / 2
            return (low / 2, high * 2) if self.log_x else (low - slack, high + slack)
        if self.log_x:
            return (low / (high / low) ** 0.03, high * (high / low) ** 0.03) if signs else (low, high)
        slack = (0.05 if self.equal else 0.03 if signs else 0.0) * (high - low)
        return low - slack, high + slack

    def _upright(self) -> tuple[float, float]:
        """All of the vertical axis of a plane that holds something, a little more; with an `x_range`, which says how
        large it is, only the middle."""
        panel = self.panels[0]
        if self.x_range is not None:
            middle = sum(panel.range) / 2 if panel.range else 0.0
            return middle, middle
        low, high = panel.range or _ends([panel], "y", False)
        slack = 0.05 * (high - low)
        return low - slack, high + slack


def key_of(drawn: Curve | Band) -> str:
    """What a curve or a band looks like, as in a legend."""
    if isinstance(drawn, Band):
        return '<i class="key band"></i>'
    number = drawn.colour % COLOURS
    dash = (drawn.colour + drawn.colour // COLOURS) % COLOURS  # as in chart.js: colours come again with other dashes
    kind = {"line": "joined", "steps": "joined"}.get(drawn.style, drawn.style)
    return f'<i class="key {kind} {f"k{number} d{dash}" if drawn.tone == "data" else drawn.tone}"></i>'


def _ends(panels: Sequence[Panel], axis: Literal["x", "y"], log: bool) -> tuple[float, float]:
    """Lowest and highest of an axis."""
    low, high = math.inf, -math.inf
    for panel in panels:
        drawn = [getattr(curve, axis) for curve in panel.curves]
        drawn += [band.x for band in panel.bands] if axis == "x" else []
        drawn += [[getattr(mark, axis)] for mark in panel.marks if isinstance(mark, ChartPoint)]
        for values in drawn:
            array = np.asarray(values, dtype=float)
            array = array[np.isfinite(array) & (array > 0)] if log else array[np.isfinite(array)]
            if len(array):
                low, high = min(low, float(array.min())), max(high, float(array.max()))
    return (low, high) if low <= high else (1.0, 10.0)


def _panel(panel: Panel, columns: Columns) -> PanelDocument:
    return {
        "title": panel.title,
        "log": panel.log,
        "range": panel.range,
        "curves": [_curve(curve, columns) for curve in panel.curves],
        "bands": [_band(band, columns) for band in panel.bands],
        "marks": [_mark(mark) for mark in panel.marks],
    }


def _curve(curve: Curve, columns: Columns) -> CurveDocument:
    x, y = _pair(curve.x, curve.y)
    rising = _rises(x)
    if not np.isfinite(x).all():
        y = np.where(np.isfinite(x), y, np.nan)  # what has no place leaves a gap, too
    return {
        "label": curve.label,
        "x": columns.add(x, rising),
        "y": columns.add(y),
        "rising": rising,
        "style": curve.style,
        "colour": curve.colour,
        "tone": curve.tone,
    }


def _band(band: Band, columns: Columns) -> BandDocument:
    x, lower = _pair(band.x, band.lower)
    _, upper = _pair(band.x, band.upper)
    if not _rises(x):
        raise ValueError(f"the band '{band.label}' does not increase in x")
    return {"label": band.label, "x": columns.add(x, True), "lower": columns.add(lower), "upper": columns.add(upper)}


def _mark(mark: ChartLine | ChartPoint) -> MarkDocument:
    document: MarkDocument = {"label": mark.label, "wrong": mark.wrong}
    if isinstance(mark, ChartPoint):
        return document | {"x": mark.x, "y": mark.y}
    document[mark.axis] = mark.value
    return document | {"span": mark.span}


def _pair(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    across, up = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if across.ndim != 1 or across.shape != up.shape:
        raise ValueError(f"x has shape {across.shape} and y {up.shape}")
    return across, up


def _rises(x: FloatArray) -> bool:
    return bool(np.all(x[1:] > x[:-1]) and np.all(np.isfinite(x[:1])))


def _json(document: ChartDocument) -> str:
    """JSON that ends no element of a page."""
    written = json.dumps(document, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return written.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
