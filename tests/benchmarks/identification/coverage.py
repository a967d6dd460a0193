"""Do the 95 % intervals of output error hold the truth on rigs of real FMUs, local ones and profiles?

The noise is drawn anew for each seed. Of a rig with a constant wrong no interval has to hold the truth; but where one
does not, the result has to say that intervals speak of the best fit.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from tests.benchmarks.figure import Figure, band, share_inside
from tests.support.covered_rigs import BUTTERFLY, RIGS, TWO_MASSES, WRONG, WRONG_MASSES, Draw, Rig, draws

DRAWS, MANY, FEW = 40, 500, 24
ASKED = (0.93, 0.97)  # where there are draws enough to tell


def figures(count: int = DRAWS, asked: tuple[float, float] | None = None) -> list[Figure]:
    """Coverage by rig and parameter; asked of profiles, of local intervals where nothing bends them, and else told."""
    found = [figure for rig in RIGS for figure in _coverage(rig, draws(rig, count, _processes()), asked)]
    return [*found, unsaid(WRONG, draws(WRONG, count, _processes()))]


def endurance() -> list[Figure]:
    """Many draws, and rigs whose cost is rough by play."""
    found = figures(MANY, ASKED)
    found += _coverage(TWO_MASSES, draws(TWO_MASSES, FEW, _processes()), None)
    return [*found, unsaid(WRONG_MASSES, draws(WRONG_MASSES, FEW, _processes()))]


def _processes() -> int:
    return os.cpu_count() or 1


def _coverage(rig: Rig, found: Sequence[Draw], asked: tuple[float, float] | None) -> list[Figure]:
    rows, own = [], band(len(found))
    for name, true in rig.truth.items():
        profile = share_inside([draw.profile[name] for draw in found], true)
        local = share_inside([draw.local[name] for draw in found], true)
        rows.append(_share(f"{rig.name}: {name} by profile", profile, asked or own, len(found)))
        rows.append(
            _share(f"{rig.name}: {name}, local", local, band(len(found)) if rig is BUTTERFLY else None, len(found))
        )
    return rows


def _share(name: str, share: float, asked: tuple[float, float] | None, count: int) -> Figure:
    if asked is None:
        return Figure(name, "-", f"{100 * share:.1f} %")
    low, high = asked
    said = f"{100 * low:.0f} to {100 * high:.0f} % of {count}"
    return Figure(name, said, f"{100 * share:.1f} %", low <= share <= high, True)


def unsaid(rig: Rig, found: Sequence[Draw]) -> Figure:
    """How often a truth lies outside of its interval without a word that intervals speak of the best fit."""
    outside = [any(share_inside([draw.profile[n]], true) == 0 for n, true in rig.truth.items()) for draw in found]
    silent = sum(out and not draw.told for out, draw in zip(outside, found, strict=True))
    what = f"{rig.name}: truths outside, unsaid"
    return Figure(what, "0", f"{silent} of {sum(outside)} of {len(found)} draws", silent == 0, True)
