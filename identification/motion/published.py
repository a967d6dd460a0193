"""Recalibration as published: Eq. 118, the mean square of what Eq. 115 leaves over from step to step.

Source: Angelchev Shiryaev 2024, Section 4.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from identification.motion.motion import Motion, positive
from orchestrator.trace import FloatArray

FACTOR = 2.0  # from the start to the bounds


def one_step_errors(motion: Motion, p: FloatArray, gain: float, target: float) -> FloatArray:
    """(K - 1,) I(t) - exp(-p4 gain dS) I(t - h) for `p` = (p1, p3, p4) [J]; Eq. 118 is their mean square (Eq. 115)."""
    invariant = motion.invariant(p[0], p[1], target)
    return np.asarray(invariant[1:] - np.exp(-p[2] * gain * np.diff(motion.action)) * invariant[:-1])


def recalibrate_as_published(motions: Sequence[Motion], gain: float, target: float, start: FloatArray) -> FloatArray:
    """(p1, p3, p4) that minimise Eq. 118, between 1/`FACTOR` and `FACTOR` times the `start` (3,).

    With E* given the index is exactly zero for p1 = p3 = p4 = 0, too, and noise pulls towards that: the result is right
    for exact signals, for others it is on or near the lower bounds. No standard error is given as none would be right.
    """
    positive(gain=gain, target=target)

    def errors(q: FloatArray) -> FloatArray:
        return np.concatenate([one_step_errors(motion, start * q, gain, target) for motion in motions]) / target

    run = least_squares(errors, np.ones(3), bounds=(1 / FACTOR, FACTOR), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.asarray(start * run.x)
