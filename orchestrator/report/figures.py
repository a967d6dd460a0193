"""The figures of the reports, each a function from results to a drawing; units stand on the axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.display.titles import with_unit
from orchestrator.report.chart import HEIGHT, Band, Chart, Curve, Panel
from orchestrator.report.drawings import Bars, ChartGrid, Correlations, Stack
from orchestrator.report.intervals import IntervalChart, IntervalRow
from orchestrator.trace import FloatArray, Trace

Response = tuple[str, ArrayLike, ArrayLike]  # label, angular frequency (N,) [rad/s], magnitude (N,)


NONE = 0.5  # how high no count at all is drawn on a logarithmic axis


def overlay(measured: Trace, simulated: Sequence[tuple[str, Trace]] = ()) -> Chart:
    """Measured and simulated signals over time, a window a signal of the measured ones."""
    panels = [Panel(_axis_title(measured, name), _curves(name, measured, simulated)) for name in measured.names]
    return Chart(panels, legend=bool(simulated))


def overlays_grid(windows: Sequence[tuple[str, Trace, Sequence[tuple[str, Trace]]]], signal: str) -> ChartGrid:
    """One signal in many small windows: (title, measured, [(label, simulated)]) each."""
    return ChartGrid(
        [
            (
                title,
                Chart([Panel(_axis_title(measured, signal), _curves(signal, measured, simulated))], legend=False),
            )
            for title, measured, simulated in windows
        ]
    )


def residuals(
    time: ArrayLike, residual: ArrayLike, correlation: ArrayLike, band: float, unit: str = "", name: str = "residual"
) -> Stack:
    """A residual (K,) over time (K,) [s], and its autocorrelation (L + 1,) from lag 0 on with the band of white noise.

    Args:
        band: a white residual's autocorrelations lie within +- this.
    """
    heights = np.asarray(correlation, dtype=float)[1:]
    lags = np.arange(1.0, len(heights) + 1)
    ends = np.array([0.5, len(heights) + 0.5])
    white = Band("of white noise", ends, np.full(2, -band), np.full(2, band))
    correlated = Panel("autocorrelation", [Curve("autocorrelation", lags, heights, "stems")], bands=[white])
    return Stack(
        [
            Chart([Panel(with_unit(name, unit), [Curve(name, time, residual)])]),
            Chart([correlated], x="lag [samples]"),
        ]
    )


def frequency_response(points: Sequence[Response], curves: Sequence[Response] = ()) -> Chart:
    """Magnitudes over frequency in decibels: measured points and model curves."""
    drawn = [Curve(label, w, _decibel(gain), colour=number) for number, (label, w, gain) in enumerate(curves)]
    drawn += [Curve(label, w, _decibel(gain), "dots", number) for number, (label, w, gain) in enumerate(points)]
    return Chart([Panel("magnitude [dB]", drawn)], x="frequency [rad/s]", log_x=True, height=2 * HEIGHT)


def points(
    groups: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    x: str,
    y: str,
    limit: float | None = None,
    logarithmic: bool = False,
) -> Chart:
    """Points (x, y) in named groups, under titled axes; `limit` ends the x axis, `logarithmic` is the y axis."""
    drawn = [
        Curve(name, across, up, style=("dots", "circles", "crosses")[number % 3], colour=number)
        for number, (name, (across, up)) in enumerate(groups.items())
    ]
    shown = None if limit is None else (0.0, limit)
    return Chart([Panel(y, drawn, log=logarithmic)], x=x, height=2 * HEIGHT, x_range=shown)


def bars(
    groups: Mapping[str, Mapping[str, float]], target: float | None = None, quantity: str = "", unit: str = ""
) -> Bars:
    """Values by name in groups (such as train and validation), and the line they are to reach."""
    return Bars(groups, with_unit(quantity, unit), target)


def correlation_heatmap(names: Sequence[str], matrix: ArrayLike) -> Correlations:
    """Correlation coefficients (N, N) between N estimates."""
    return Correlations(names, np.asarray(matrix, dtype=float))


def intervals(rows: Sequence[IntervalRow]) -> IntervalChart:
    """Estimates with their intervals, each on a scale of its own, and where they are true where that is known."""
    return IntervalChart(rows)


def distribution(values: ArrayLike, quantity: str, unit: str | None = None) -> Chart:
    """Histogram of values (N,)."""
    sample = np.asarray(values, dtype=float)
    counts, edges = np.histogram(sample, bins="auto" if np.ptp(sample) else 1)
    return Chart([Panel("count", [_outline(edges, counts.astype(float), 0.0)])], x=with_unit(quantity, unit))


def counts(bins: Sequence[tuple[float, float, int]], quantity: str, unit: str | None = None) -> Chart:
    """How many fell into each bin (lower end, upper end, count), which widen from one to the next, on both axes
    logarithmic."""
    ends = np.array([max(bins[0][0], bins[0][1] / 2), *(high for _, high, _ in bins)])
    heights = np.array([max(float(count), NONE) for _, _, count in bins])
    return Chart([Panel("count", [_outline(ends, heights, NONE)], log=True)], x=with_unit(quantity, unit), log_x=True)


def _outline(edges: FloatArray, heights: FloatArray, floor: float) -> Curve:
    """Bins (N + 1,) of these heights (N,) as one line that begins and ends on the floor."""
    return Curve("count", np.repeat(edges, 2), np.concatenate([[floor], np.repeat(heights, 2), [floor]]))


def _decibel(magnitude: ArrayLike) -> FloatArray:
    decibel: FloatArray = 20 * np.log10(np.asarray(magnitude, dtype=float))
    return decibel


def _axis_title(trace: Trace, signal: str) -> str:
    return with_unit(signal, trace.unit(signal))


def _curves(signal: str, measured: Trace, simulated: Sequence[tuple[str, Trace]]) -> list[Curve]:
    """Where they have the signal: a broad pale curve for what was measured, thin ones for the models on top of it."""
    found = [
        Curve(label, trace.time, trace[signal], colour=i)
        for i, (label, trace) in enumerate(simulated)
        if signal in trace.names
    ]
    if signal not in measured.names:
        return found
    return [Curve("measured", measured.time, measured[signal], tone="measured" if simulated else "data"), *found]
