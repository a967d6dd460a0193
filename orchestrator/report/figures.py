"""The figures of the reports, each a function from results to a plotly figure in the common look.

Units stand on the axes; curves are thinned so that their peaks stay.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike
from plotly.subplots import make_subplots

from orchestrator.display import look
from orchestrator.display.curves import TimeCurve, stacked
from orchestrator.display.thinning import thin
from orchestrator.trace import FloatArray, Trace

Curve = tuple[str, ArrayLike, ArrayLike]  # label, angular frequency (N,) [rad/s], magnitude (N,)


NONE = 0.5  # how high no count at all is drawn on a logarithmic axis


def overlay(measured: Trace, simulated: Sequence[tuple[str, Trace]] = (), signals: Sequence[str] = ()) -> go.Figure:
    """Measured and simulated signals over time, a window a signal (all of `measured` by default)."""
    names = list(signals) or list(measured.names)
    windows = [(_axis_title(measured, name), _curves(name, measured, simulated)) for name in names]
    return stacked(windows, legend=bool(simulated))


def overlays_grid(
    windows: Sequence[tuple[str, Trace, Sequence[tuple[str, Trace]]]], signal: str, columns: int = 3
) -> go.Figure:
    """One signal in many small windows: (title, measured, [(label, simulated)]) each."""
    rows = -(-len(windows) // columns)
    height = 80 + 165 * rows
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[look.plain(title) for title, _, _ in windows],
        vertical_spacing=min(0.5 / rows, 55 / height),
        horizontal_spacing=0.045,
    )
    figure.update_annotations(font_size=12)
    for number, (_, measured, simulated) in enumerate(windows):
        place = {"row": number // columns + 1, "col": number % columns + 1}
        for curve in _curves(signal, measured, simulated):
            figure.add_trace(curve.line(number == 0, limit=500), **place)
        if number % columns == 0:
            figure.update_yaxes(title_text=_axis_title(measured, signal), **place)
        if number + columns >= len(windows):
            figure.update_xaxes(title_text="time [s]", **place)
    figure = look.styled(figure, height)
    return figure.update_layout(margin_t=60, legend={"y": 1, "yref": "container", "yanchor": "top"})


def residuals(
    time: ArrayLike, residual: ArrayLike, correlation: ArrayLike, band: float, unit: str = "", name: str = "residual"
) -> go.Figure:
    """A residual (K,) over time (K,) [s], and its autocorrelation (L + 1,) from lag 0 on with the band of white noise.

    Args:
        band: a white residual's autocorrelations lie within +- this.
    """
    figure = make_subplots(rows=2, cols=1, vertical_spacing=0.2)
    x, y = thin(np.asarray(time, dtype=float), np.asarray(residual, dtype=float))
    figure.add_scatter(x=x, y=y, line={"color": look.colour(0), "width": 1.1}, name=name, row=1, col=1)
    heights = np.asarray(correlation, dtype=float)[1:]
    figure.add_bar(
        x=np.arange(1, len(heights) + 1),
        y=heights,
        marker_color=look.colour(0),
        name="autocorrelation",
        width=0.35,
        row=2,
        col=1,
    )
    figure.add_hrect(y0=-band, y1=band, fillcolor=look.BAND, line_width=0, layer="below", row=2, col=1)
    figure.update_yaxes(title_text=look.with_unit(name, unit), row=1, col=1)
    figure.update_xaxes(title_text="time [s]", row=1, col=1)
    figure.update_yaxes(title_text="autocorrelation", row=2, col=1)
    figure.update_xaxes(title_text="lag [samples]", row=2, col=1)
    return look.styled(figure, 520).update_layout(showlegend=False)


def frequency_response(points: Sequence[Curve], curves: Sequence[Curve] = (), unit: str = "") -> go.Figure:
    """Magnitudes over frequency: measured points and model curves, in decibels of `unit`."""
    figure = go.Figure()
    for number, (label, omega, magnitude) in enumerate(curves):
        line = {"color": look.colour(number), "width": 1.8}
        figure.add_scatter(x=omega, y=_decibel(magnitude), mode="lines", line=line, name=look.plain(label))
    for number, (label, omega, magnitude) in enumerate(points):
        marker = {"color": look.colour(number), "size": 8, "line": {"width": 1, "color": "#ffffff"}}
        figure.add_scatter(x=omega, y=_decibel(magnitude), mode="markers", marker=marker, name=look.plain(label))
    figure.update_xaxes(type="log", title_text="frequency [rad/s]", dtick="D2", tickformat="~g")
    figure.update_yaxes(title_text=look.with_unit("magnitude", f"dB re 1 {unit}" if unit else "dB"))
    return look.styled(figure, 440)


def points(
    groups: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    x: str,
    y: str,
    limit: float | None = None,
    logarithmic: bool = False,
) -> go.Figure:
    """Points (x, y) in named groups, under titled axes; `limit` ends the x axis, `logarithmic` is the y axis."""
    figure = go.Figure()
    for number, (name, (across, up)) in enumerate(groups.items()):
        marker = {"color": look.colour(number), "size": 6}
        figure.add_scatter(x=across, y=up, mode="markers", marker=marker, name=look.plain(name))
    figure.update_xaxes(title_text=x, range=None if limit is None else [0, limit])
    figure.update_yaxes(title_text=y, type="log" if logarithmic else "linear")
    return look.styled(figure, 440).update_layout(hovermode="closest")


def bars(
    groups: Mapping[str, Mapping[str, float]], target: float | None = None, quantity: str = "", unit: str = ""
) -> go.Figure:
    """Values by name in groups (such as train and validation), and the line they are to reach."""
    figure = go.Figure()
    for number, (group, values) in enumerate(groups.items()):
        figure.add_bar(
            y=[look.plain(name) for name in values],
            x=list(values.values()),
            orientation="h",
            name=look.plain(group),
            marker_color=look.colour(number),
            marker_opacity=0.85,
        )
    if target is not None:
        look.mark(figure, target, f"target {target:g}")
    figure.update_xaxes(title_text=look.with_unit(quantity, unit))
    figure.update_yaxes(autorange="reversed", type="category", showgrid=False)
    figure = look.styled(figure, 110 + 22 * sum(map(len, groups.values())))
    names = [name for values in groups.values() for name in values]
    barmode = "overlay" if len(set(names)) == len(names) else "group"
    legend = len(groups) > 1
    return figure.update_layout(bargap=0.35, barmode=barmode, hovermode="closest", showlegend=legend)


def correlation_heatmap(names: Sequence[str], matrix: ArrayLike) -> go.Figure:
    """Correlation coefficients (N, N) between N estimates."""
    labels = [look.plain(name) for name in names]
    figure = go.Figure(
        go.Heatmap(
            z=np.asarray(matrix, dtype=float),
            x=labels,
            y=labels,
            zmin=-1,
            zmax=1,
            colorscale=look.DIVERGING,
            texttemplate="%{z:.2f}",
            xgap=2,
            ygap=2,
            colorbar={"thickness": 10, "outlinewidth": 0},
            hovertemplate="%{y}, %{x}: %{z:.3f}<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed")
    figure = look.styled(figure, 130 + 42 * len(names))
    figure.update_xaxes(showgrid=False, showline=False, type="category")
    figure.update_yaxes(showgrid=False, showline=False, type="category")
    return figure.update_layout(hovermode="closest")


def distribution(
    values: ArrayLike, quantity: str, unit: str | None = None, marks: Mapping[str, float] | None = None
) -> go.Figure:
    """Histogram of values (N,), with named marks such as a true value or the ends of an interval."""
    figure = go.Figure()
    low, high, counts = _bins(np.asarray(values, dtype=float))
    figure.add_bar(x=(low + high) / 2, y=counts, width=high - low, marker_color=look.colour(0), marker_opacity=0.8)
    for name, value in (marks or {}).items():
        look.mark(figure, value, name)
    figure.update_xaxes(title_text=look.with_unit(quantity, unit))
    figure.update_yaxes(title_text="count")
    return look.styled(figure, 340).update_layout(bargap=0.04, showlegend=False, hovermode="closest")


def counts(bins: Sequence[tuple[float, float, int]], quantity: str, unit: str | None = None) -> go.Figure:
    """How many fell into each bin (lower end, upper end, count), which widen from one to the next, on both axes
    logarithmic."""
    ends = [max(bins[0][0], bins[0][1] / 2), *(high for _, high, _ in bins)]
    heights = [max(count, NONE) for _, _, count in bins]
    figure = go.Figure()
    figure.add_scatter(
        x=ends,
        y=[heights[0], *heights],
        mode="lines",
        line={"shape": "vh", "color": look.colour(0)},
        fill="tozeroy",
        name="count",
    )
    figure.update_xaxes(title_text=look.with_unit(quantity, unit), type="log", dtick=1)
    figure.update_yaxes(title_text="count", type="log", dtick=1, range=[math.log10(NONE), None])
    return look.styled(figure, 340).update_layout(showlegend=False, hovermode="closest")


def _bins(values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lower ends, upper ends and counts of the bins of a histogram."""
    counts, edges = np.histogram(values, bins="auto" if np.ptp(values) else 1)
    return edges[:-1], edges[1:], counts.astype(float)


def _decibel(magnitude: ArrayLike) -> FloatArray:
    decibel: FloatArray = 20 * np.log10(np.asarray(magnitude, dtype=float))
    return decibel


def _axis_title(trace: Trace, signal: str) -> str:
    return look.with_unit(signal, trace.unit(signal))


def _curves(signal: str, measured: Trace, simulated: Sequence[tuple[str, Trace]]) -> list[TimeCurve]:
    """Where they have the signal: a broad pale curve for what was measured, thin ones for the models on top of it."""
    drawn = [("measured", measured, look.MEASURED if simulated else look.colour(0), 3.2 if simulated else 1.3)]
    drawn += [(label, trace, look.colour(number), 1.4) for number, (label, trace) in enumerate(simulated)]
    return [
        TimeCurve(label, trace.time, trace[signal], colour, width)
        for label, trace, colour, width in drawn
        if signal in trace.names
    ]
