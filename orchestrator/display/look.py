"""The look of the figures that notebooks show; it is readable on light and on dark paper."""

from __future__ import annotations

from html import escape

import plotly.graph_objects as go

from orchestrator.display import titles

COLOURS = ("#2f7fe0", "#e0702a", "#1f9d6b", "#a05fd0", "#d0487f", "#b08a1e")
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'

AXIS = {
    "showline": True,
    "linecolor": "#b9c1cb",
    "gridcolor": "#e9ecf0",
    "zeroline": False,
    "ticks": "",
    "title": {"standoff": 8, "font": {"size": 13}},
    "automargin": True,
}


def styled(figure: go.Figure, height: int) -> go.Figure:
    """The figure in the common look, `height` pixels high."""
    figure.update_xaxes(AXIS)
    figure.update_yaxes(AXIS)
    figure.update_layout(
        template=go.layout.Template(),
        height=height,
        margin={"l": 64, "r": 12, "t": 34, "b": 44},
        font={"family": FONT, "size": 12, "color": "#5a6675"},
        paper_bgcolor="rgba(0, 0, 0, 0)",
        plot_bgcolor="rgba(0, 0, 0, 0)",
        colorway=COLOURS,
        hovermode="x unified",
        hoverlabel={"namelength": -1, "bgcolor": "#ffffff", "font": {"color": "#1b2430"}},
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1,
            "yanchor": "bottom",
            "yref": "paper",
            "font": {"size": 13},
        },
        modebar={"bgcolor": "rgba(0, 0, 0, 0)", "color": "#97a1af", "activecolor": COLOURS[0]},
    )
    return figure


def plain(text: str) -> str:
    """Text that plotly shows as it is: its own markup is switched off."""
    return escape(text, quote=False)


def with_unit(name: str, unit: str | None) -> str:
    """The title of an axis, as plotly shows it."""
    return plain(titles.with_unit(name, unit))
