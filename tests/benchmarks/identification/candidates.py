"""Does a calibration with candidates choose the right one? Five friction laws, each simulated, noise drawn anew.

Of each draw the same recordings are fitted by all five laws. Some have the right one as a special case, so that a
freedom that nothing needs has to be recognised as well as one that is needed.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from tests.benchmarks.figure import Figure
from tests.support.identification.friction_laws import LAWS, Draw, choices, draws

DRAWS = 200
ASKED = 0.95


def figures(count: int = DRAWS) -> list[Figure]:
    """How often the right law is chosen, of all and by law."""
    asked = draws(count)
    found = choices(asked, os.cpu_count() or 1)
    rows = [_figure("all laws", asked, found, ASKED)]
    for law in LAWS:
        own = [number for number, (truth, _) in enumerate(asked) if truth == law]
        rows.append(_figure(law, [asked[number] for number in own], [found[number] for number in own], None))
    return rows


def _figure(name: str, asked: Sequence[Draw], found: Sequence[str], least: float | None) -> Figure:
    right = sum(law == chosen for (law, _), chosen in zip(asked, found, strict=True))
    share = right / len(asked)
    said = "-" if least is None else f"at least {100 * least:.0f} %"
    holds = None if least is None else share >= least
    return Figure(f"the right candidate, {name}", said, f"{right} of {len(asked)}, {100 * share:.1f} %", holds, True)
