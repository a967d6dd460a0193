"""One measured figure, and the table and exit code that a list of them makes.

The benches fail only where a claim falls short that no machine changes; of speed and memory the table says it.
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
        certain: whether no machine changes it, so that falling short fails the benches.
    """

    name: str
    asked: str
    measured: str
    holds: bool | None = None
    certain: bool = False


def table(groups: Mapping[str, Sequence[Figure]]) -> str:
    """The figures as aligned columns, each group below its name where it has one."""
    words = {True: "pass", False: "FALLS SHORT", None: "-"}
    rows = [("figure", "asked", "measured", "")]
    for name, figures in groups.items():
        rows += [("",) * 4, (f"{name}:", "", "", "")] if name else []
        rows += [(f.name, f.asked, f.measured, words[f.holds]) for f in figures]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    rows.insert(1, ("-" * widths[0], "-" * widths[1], "-" * widths[2], "-" * widths[3]))
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def report_groups(groups: Mapping[str, Sequence[Figure]]) -> int:
    """Print the table of groups by name, and which certain claims fall short; the exit code is 1 where one does."""
    print(table(groups))
    short = [
        f"{group}: {figure.name}" if group else figure.name
        for group, figures in groups.items()
        for figure in figures
        if figure.certain and figure.holds is not None and not figure.holds
    ]
    if short:
        print("\nfalls short on any machine:", *short, sep="\n  ")
    return int(bool(short))


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
