"""A recorded motion near an orbit of energy control: what of its signals the relations of Section 4 are made of.

Source: Angelchev Shiryaev 2024, Section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson

from fmus.errors import IdentificationError
from identification.signals.processing import differentiate, mean_step, resampled_evenly
from orchestrator.trace import FloatArray, ReadOnlyArrays, Trace, usable

HALF_WIDTH, DEGREE = 5, 3  # of the polynomials that a speed is taken from, where none was recorded
UNITS = {"ratio": "1/s^2", "level": "rad^2/s^2", "rate": "s/rad^2", "p1": "kg m^2", "p3": "N m", "p4": "N m/V"}


@dataclass(frozen=True, eq=False)
class Motion(ReadOnlyArrays):
    """A recorded motion.

    Attributes:
        time: (K,) [s].
        angle: (K,) from the downward equilibrium [rad].
        speed: (K,) [rad/s].
        action: (K,) integral of the squared speed since the first sample [rad^2/s].
        derivative: (2 HALF_WIDTH + 1,) weights of the angles around a sample that make its speed [1/s]; None where the
            speed was recorded.
        voltage: (K,) command that holds from each sample to the next [V]; None where it was not recorded.
        work: (K,) integral of voltage times speed since the first sample [V rad].
        name: of its recording.
    """

    time: FloatArray
    angle: FloatArray
    speed: FloatArray
    action: FloatArray
    derivative: FloatArray | None = None
    voltage: FloatArray | None = None
    work: FloatArray | None = None
    name: str = "motion"

    def invariant(self, p1: float, p3: float, target: float) -> FloatArray:
        """(K,) I of Eq. 110 [J]."""
        return np.asarray(0.5 * p1 * self.speed**2 + p3 * (1 - np.cos(self.angle)) - target)

    @property
    def period(self) -> float:
        """Mean time from one swing to the next [s], by the angle's passages through the middle of its range.

        Raises:
            IdentificationError: it does not swing to and fro.
        """
        middle = 0.5 * (float(self.angle.max()) + float(self.angle.min()))
        band = 0.1 * float(np.ptp(self.angle))
        far = np.flatnonzero(np.abs(self.angle - middle) > band)
        turns = far[1:][np.diff(np.sign(self.angle[far] - middle)) != 0]
        if len(turns) < 3:
            raise IdentificationError(self.name, "does not swing to and fro", "record an oscillation of some periods")
        return float(2 * (self.time[turns[-1]] - self.time[turns[0]]) / (len(turns) - 1))

    @property
    def amplitude(self) -> float:
        """Half of the range of the angle over the last three periods [rad]."""
        return 0.5 * float(np.ptp(self.angle[self.time > self.time[-1] - 3 * self.period]))


def recorded_motion(
    trace: Trace,
    angle: str = "angle",
    speed: str | None = "speed",
    equilibrium_angle: float = 0.0,
    voltage: str | None = None,
) -> Motion:
    """The motion in a trace; with `speed` None its speed is the derivative of the evenly resampled angle.

    Raises:
        TraceError: a signal is missing, constant or not finite.
        IdentificationError: too few samples.
    """
    trace = usable(trace, [name for name in (angle, speed, voltage) if name is not None])
    if len(trace) < 20:
        raise IdentificationError(trace.name, f"holds {len(trace)} samples", "record a motion of 20 samples or more")
    held = None if voltage is None else trace[voltage]
    work = None if held is None else np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(trace[angle]))])
    if speed is not None:
        measured = trace[angle] - equilibrium_angle
        return Motion(
            trace.time, measured, trace[speed], _action(trace.time, trace[speed]), None, held, work, trace.name
        )
    even = resampled_evenly(trace.select([angle]))
    inner, period = slice(HALF_WIDTH, -HALF_WIDTH), mean_step(even.time)
    time, derived = even.time[inner], differentiate(even[angle], period, HALF_WIDTH, DEGREE)[inner]
    from scipy.signal import savgol_coeffs  # noqa: PLC0415 - loads slowly

    weights = savgol_coeffs(2 * HALF_WIDTH + 1, DEGREE, deriv=1, delta=period, use="dot")
    return Motion(
        time,
        even[angle][inner] - equilibrium_angle,
        derived,
        _action(time, derived),
        weights,
        None if voltage is None else trace.resampled(time, hold=[voltage])[voltage],
        None if work is None else np.interp(time, trace.time, work),
        trace.name,
    )


def _action(time: FloatArray, speed: FloatArray) -> FloatArray:
    return np.asarray(cumulative_simpson(speed**2, x=time, initial=0.0))


def positive(**numbers: float) -> None:
    """See that all are positive and finite.

    Raises:
        IdentificationError: one is not.
    """
    for name, number in numbers.items():
        if not (number > 0 and np.isfinite(number)):
            raise IdentificationError(f"recalibration.{name}", f"{number:g} is not positive", "give its true value")
