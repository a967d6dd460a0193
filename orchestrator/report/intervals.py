"""Estimates with their intervals under each other, each on a scale of its own: in percent of the estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from orchestrator.display.table import text
from orchestrator.display.titles import with_unit
from orchestrator.report.columns import Columns

WIDEST = 100.0  # of the scale, to either side [% of the estimate]


@dataclass(frozen=True)
class IntervalRow:
    """An estimate, the ends of its interval, and what it is held against, all in `unit`; None is not known."""

    name: str
    value: float
    ends: tuple[float, float] | None
    unit: str = ""
    truth: float | None = None

    def percent(self, value: float) -> float:
        """How far a value is from the estimate [% of its magnitude]; infinite from an estimate of nothing."""
        off = value - self.value
        return 0.0 if not off else 100 * off / abs(self.value) if self.value else math.copysign(math.inf, off)


@dataclass(frozen=True)
class IntervalChart:
    """A row an estimate; a line is where it is true, where that is known, and a sign says whether it is inside."""

    rows: Sequence[IntervalRow]

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        scale = self._scale()
        known = any(row.truth is not None for row in self.rows)
        head = ["", "estimate", "± 95 %", f"−{scale:g} % … +{scale:g} % of the estimate", *(["truth"] if known else [])]
        heads = "".join(f"<th>{escape(one)}</th>" for one in head)
        rows = "".join(_row(row, scale, known) for row in self.rows)
        return (
            f'<div class="table" tabindex="0"><table class="bars intervals"><thead><tr>{heads}</tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )

    def _scale(self) -> float:
        """How far the scale reaches: as far as what is widest on it, at most `WIDEST` [%]."""
        far = [abs(row.percent(end)) for row in self.rows for end in (*(row.ends or ()), row.truth) if end is not None]
        widest = max((one for one in far if math.isfinite(one)), default=1.0) or 1.0
        power = 10.0 ** math.floor(math.log10(widest))
        return min(next(power * step for step in (1, 2, 5, 10) if power * step >= widest * 0.999), WIDEST)


def _row(row: IntervalRow, scale: float, known: bool) -> str:
    def place(value: float) -> float:
        return round(50 + 50 * min(max(row.percent(value) / scale, -1.0), 1.0), 3)

    half = None if row.ends is None else (row.ends[1] - row.ends[0]) / 2
    shapes, told = "", ""
    if row.ends is not None:
        low, high = map(place, row.ends)
        beyond = " beyond" if max(abs(row.percent(end)) for end in row.ends) > scale else ""
        shapes = f'<i class="k0{beyond}" style="left:{low}%;width:{high - low:.3f}%"></i>'
    if row.truth is not None:
        shapes += f'<b style="left:{place(row.truth)}%"></b>'
        inside = row.ends is not None and row.ends[0] <= row.truth <= row.ends[1]
        told = f"{'inside' if inside else 'outside'}: {text(row.truth)}"
    cells = "".join(f'<td class="n">{escape(text(one))}</td>' for one in (row.value, half))
    shapes += '<s style="left:50%"></s>'
    truth = f"<td>{escape(told)}</td>" if known else ""
    return f'<tr><th>{escape(with_unit(row.name, row.unit))}</th>{cells}<td class="bar">{shapes}</td>{truth}</tr>'
