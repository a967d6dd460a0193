"""Curves over time in windows above each other, thinned so that their peaks stay."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from orchestrator.display import look
from orchestrator.display.thinning import Samples, thin

ROW = 210  # height of a window [px]


def stacked(windows: Sequence[tuple[str, str | None, Samples, Samples]]) -> go.Figure:
    """Windows (name, unit, time (K,) [s], values (K,)) above each other over one time axis."""
    rows = max(len(windows), 1)
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=min(0.5 / rows, 26 / (ROW * rows)))
    for row, (name, unit, time, values) in enumerate(windows, 1):
        x, y = thin(time, values)
        line = {"color": look.COLOURS[0], "width": 1.3}
        figure.add_trace(go.Scatter(x=x, y=y, mode="lines", line=line, name=look.plain(name)), row=row, col=1)
        figure.update_yaxes(title_text=look.with_unit(name, unit), row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=rows, col=1)
    return look.styled(figure, 80 + ROW * rows).update_layout(showlegend=False)
