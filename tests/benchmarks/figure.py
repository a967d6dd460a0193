"""One measured figure, and the table and exit code that a list of them makes.

A benchmark fails only where a statistical claim does; speed and memory depend on the machine and are only shown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy import stats

Interval = tuple[float, float]


@dataclass(frozen=True)
class Figure:
    """What was asked of a quantity and what it is.

    Attributes:
        holds: None where nothing is asked.
        statistical: whether a claim that does not hold fails the benchmarks.
    """

    name: str
    asked: str
    measured: str
    holds: bool | None = None
    statistical: bool = False


def table(groups: Mapping[str, Sequence[Figure]]) -> str:
    """The figures as aligned columns, each group below its name where it has one."""
    words = {True: "yes", False: "NO", None: "-"}
    rows = [("name", "asked", "measured", "holds")]
    for name, figures in groups.items():
        rows += [("",) * 4, (f"{name}:", "", "", "")] if name else []
        rows += [(f.name, f.asked, f.measured, words[f.holds]) for f in figures]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    rows.insert(1, ("-" * widths[0], "-" * widths[1], "-" * widths[2], "-" * widths[3]))
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def report(figures: Sequence[Figure]) -> int:
    """Print the table; the exit code is 1 where a statistical claim does not hold."""
    return report_groups({"": figures})


def report_groups(groups: Mapping[str, Sequence[Figure]]) -> int:
    """Print the table of groups by name; the exit code is 1 where a statistical claim does not hold."""
    print(table(groups))
    return int(any(each.statistical and not each.holds for figures in groups.values() for each in figures))


def share_inside(intervals: Sequence[Interval], truth: float) -> float:
    """Share of the intervals that hold the truth."""
    return sum(low <= truth <= high for low, high in intervals) / len(intervals)


def band(draws: int) -> Interval:
    """Between which shares an exact 95 % interval covers in 95 % of all sets of so many draws."""
    low, high = stats.binom.interval(0.95, draws, 0.95)
    return float(low) / draws, float(high) / draws


def coverage(study: str, draws: Sequence[Mapping[str, Interval]], truth: Mapping[str, float]) -> list[Figure]:
    """For each parameter the share of draws whose 95 % interval holds the truth, beside the Monte-Carlo band."""
    low, high = band(len(draws))
    asked = f"{100 * low:.0f} to {100 * high:.0f} % of {len(draws)} draws"
    found = []
    for name, true in truth.items():
        share = share_inside([draw[name] for draw in draws], true)
        found.append(
            Figure(f"{study}: {name} in its 95 % interval", asked, f"{100 * share:.1f} %", low <= share <= high, True)
        )
    return found
