"""Curves over time in windows above each other, thinned so that their peaks stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from orchestrator.display import look
from orchestrator.display.thinning import Samples, thin

ROW = 210  # height of a window [px]


@dataclass(frozen=True, eq=False)
class TimeCurve:
    """Samples (K,) over time (K,) [s], and how they are drawn."""

    label: str
    time: Samples
    values: Samples
    colour: str
    width: float

    def line(self, legend: bool, limit: int = 2000) -> go.Scatter:
        """At most `limit` points of it; `legend` names it there."""
        x, y = thin(self.time, self.values, limit)
        return go.Scatter(
            x=x,
            y=y,
            mode="lines",
            line={"color": self.colour, "width": self.width},
            name=look.plain(self.label),
            legendgroup=look.plain(self.label),
            showlegend=legend,
        )


def stacked(windows: Sequence[tuple[str, Sequence[TimeCurve]]], legend: bool) -> go.Figure:
    """Windows (axis title, curves) above each other over one time axis."""
    rows = max(len(windows), 1)
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=min(0.5 / rows, 26 / (ROW * rows)))
    for row, (title, curves) in enumerate(windows, 1):
        for curve in curves:
            figure.add_trace(curve.line(row == 1), row=row, col=1)
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=rows, col=1)
    return look.styled(figure, 80 + ROW * rows).update_layout(showlegend=legend)
