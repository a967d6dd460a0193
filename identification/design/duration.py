"""The shortest duration of experiments after which a calibration's intervals are as narrow as they have to be."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import partial

from fmus.errors import IdentificationError
from identification.design.design import Design, design
from identification.design.study import DesignStudy, DurationTrial, Sought
from orchestrator.progress import Progress, silent


def shortest(study: DesignStudy, progress: Progress = silent) -> Design:
    """The design of the shortest duration that reaches the study's half-widths, by bisection; of the longest where none
    does.

    Each duration that is tried is designed anew: other experiments may be best.

    Raises:
        InputError, FmuError: as `design` does for the longest duration.
    """
    assert study.sought is not None
    sought, raster = study.sought, durations(study.sought, study.rig.timing.step)
    most = 2 + math.ceil(math.log2(max(len(raster) - 1, 1)))
    found: dict[int, Design] = {}
    trials: dict[int, DurationTrial] = {}

    def reached(number: int) -> bool:
        share = partial(_part, progress, len(trials), most, float(raster[number]))
        try:
            made = found[number] = design(replace(study, duration=raster[number]), share)
        except IdentificationError as error:
            if number == len(raster) - 1:
                raise
            trials[number] = DurationTrial(raster[number], math.inf, str(error))
            return False
        widths = dict(zip(made.names, map(float, made.after), strict=True))
        largest = float(made.relative(made.after).max())
        trials[number] = DurationTrial(raster[number], sought.of_target(widths, largest))
        return trials[number].of_target <= 1

    low, high = 0, len(raster) - 1
    if reached(high) and high:
        high = 0 if reached(low) else high
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if reached(middle) else (middle, high)
    return replace(found[high], trials=tuple(trials[number] for number in sorted(trials)))


def durations(sought: Sought, step: Fraction) -> list[Fraction]:
    """Those that may be tried, ascending: so far apart as the shortest is to be told, by whole steps of the rig [s]."""
    count = max(math.ceil((sought.high - sought.low) / sought.within), 1)
    even = [sought.low + (sought.high - sought.low) * Fraction(number, count) for number in range(count + 1)]
    return sorted({math.ceil(one / step) * step for one in even})


def _part(progress: Progress, done: int, most: int, seconds: float, share: float, remark: str) -> None:
    """The progress of one of several designs."""
    progress(min((done + share) / most, 1.0), f"{seconds:g} s: {remark}")
