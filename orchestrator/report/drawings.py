"""Figures that need no script: bars, correlations as a table of tones, several drawings side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from orchestrator.display.table import text
from orchestrator.report.chart import COLOURS, Chart, Curve, key_of
from orchestrator.report.columns import Columns
from orchestrator.report.content import Drawing
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class Stack:
    """Drawings above each other, each with axes of its own."""

    drawings: Sequence[Drawing]

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        return "".join(drawing.markup(f"{key}-{i}", columns, caption) for i, drawing in enumerate(self.drawings))


@dataclass(frozen=True)
class ChartGrid:
    """Small charts side by side, each below a title, with one legend."""

    charts: Sequence[tuple[str, Chart]]

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        legend: dict[str, Curve] = {}
        for _, chart in self.charts:
            for curve in (curve for panel in chart.panels for curve in panel.curves):
                legend.setdefault(curve.label, curve)
        keys = "".join(f"<span>{key_of(curve)}{escape(label)}</span>" for label, curve in legend.items())
        cells = "".join(
            f'<div><p class="small">{escape(title)}</p>{chart.markup(f"{key}-{number}", columns, title)}</div>'
            for number, (title, chart) in enumerate(self.charts)
        )
        return f'<div class="legend">{keys}</div><div class="grid">{cells}</div>'


@dataclass(frozen=True)
class Bars:
    """Values by name in groups, and the line that they are to reach; a value that is none shows as a dash."""

    groups: Mapping[str, Mapping[str, float]]
    quantity: str = ""
    target: float | None = None

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        values = [value for group in self.groups.values() for value in group.values() if np.isfinite(value)]
        known = [0.0, *values, *([] if self.target is None else [self.target])]
        low, span = min(known), (max(known) - min(known)) or 1.0

        def place(value: float) -> float:
            return round(100 * (value - low) / span, 3)

        line = "" if self.target is None else f'<b style="left:{place(self.target)}%"></b>'
        rows = []
        for number, (group, own) in enumerate(self.groups.items()):
            if len(self.groups) > 1:
                rows.append(f'<tr class="group"><th colspan="3">{escape(group)}</th></tr>')
            for name, value in own.items():
                ends = sorted((place(0.0), place(value))) if np.isfinite(value) else (0.0, 0.0)
                bar = f'<i class="k{number % COLOURS}" style="left:{ends[0]}%;width:{ends[1] - ends[0]:.3f}%"></i>'
                shown = escape(text(value if np.isfinite(value) else None))
                rows.append(
                    f'<tr><th>{escape(name)}</th><td class="n">{shown}</td><td class="bar">{bar}{line}</td></tr>'
                )
        told = f", at least {text(self.target)}" if self.target is not None else ""
        head = f"<caption>{escape(self.quantity + told)}</caption>" if self.quantity or told else ""
        return f'<div class="table" tabindex="0"><table class="bars">{head}<tbody>{"".join(rows)}</tbody></table></div>'


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlation coefficients (N, N) between N names, each with its number and a tone: blue above 0, orange below."""

    names: Sequence[str]
    matrix: FloatArray

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        head = "".join(f"<th>{escape(name)}</th>" for name in self.names)
        rows = "".join(
            f"<tr><th>{escape(name)}</th>{''.join(map(_tone, values))}</tr>"
            for name, values in zip(self.names, self.matrix, strict=True)
        )
        return (
            f'<div class="table" tabindex="0"><table class="tones"><thead><tr><td></td>{head}</tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )


def _tone(value: float) -> str:
    if not np.isfinite(value):
        return "<td>–</td>"
    strength = round(75 * min(abs(float(value)), 1.0))
    colour = "var(--c0)" if value > 0 else "var(--c1)"
    shown = f"{value:.2f}".replace("-", "−")
    return f'<td style="background:color-mix(in srgb,{colour} {strength}%,transparent)">{shown}</td>'
