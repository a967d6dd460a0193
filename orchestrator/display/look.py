"""The one look of all figures.

Text, axes and grid take their colours from the page's style sheet, which knows light and dark; the
colours here are those of the data and are readable on both.
"""

from __future__ import annotations

from html import escape

import plotly.graph_objects as go

MEASURED = "#97a1af"
COLOURS = ("#2f7fe0", "#e0702a", "#1f9d6b", "#a05fd0", "#d0487f", "#b08a1e")
BAND = "rgba(128, 140, 155, 0.16)"
DIVERGING = [
    [0.0, "rgba(224, 112, 42, 0.75)"],
    [0.5, "rgba(128, 140, 155, 0.06)"],
    [1.0, "rgba(47, 127, 224, 0.75)"],
]
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
    """An axis title, `name [unit]`; no brackets for a dimensionless or unknown quantity."""
    return plain(f"{name} [{unit}]" if unit not in (None, "", "1") else name)


def mark(figure: go.Figure, value: float, text: str) -> None:
    """A dashed vertical line at a value of the horizontal axis, with a word above it."""
    line = {"color": COLOURS[1], "width": 1.5, "dash": "dash"}
    above = {"text": plain(text), "yshift": 4}
    figure.add_vline(x=value, line=line, annotation=above, annotation_position="top")


def colour(number: int) -> str:
    """The colour of the curve with this number, from 0."""
    return COLOURS[number % len(COLOURS)]
