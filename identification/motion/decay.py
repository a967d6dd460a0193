"""Recalibration near a motion: what the approach to an orbit under energy control says about p1, p3 and p4.

Where Eq. 103 compensates the friction, the invariant of Eq. 107, I = p1/2 w^2 + p3 (1 - cos theta) - E*, obeys
I' = -p4 gain w^2 I (Eqs. 111, 112 with the speed as it was), so that

    w^2/2 + ratio (1 - cos theta) = level + offset exp(-rate S),    S = integral of w^2 dt    (Eq. 114 over p1)

with ratio = p3/p1, level = E*/p1 and rate = p4 gain: linear in all but the rate. One recording identifies exactly
these three. The relation stays true when p1, p3 and E* are multiplied by one number, so p1 and p3 themselves come
from E* and are in the controller's unit of energy: a controller whose p1 and p3 are both s times the plant's
gives s p1, s p3 and s p4 back, and only p3/p1 and p4/p1 are the plant's. Viscous friction that is left over, d w
beyond Eq. 103, moves the level by -d / (p4 gain p1); ratio and rate do not feel it.

Source: Angelchev Shiryaev 2024, Section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, propagated, with_interval
from identification.estimation.validation import whiteness
from identification.motion.motion import HALF_WIDTH, UNITS, Motion, positive
from orchestrator.trace import FloatArray

RATES = np.geomspace(0.3, 300, 40)  # decays over the recording, tried as starts
FASTEST = 1e4  # decays over the recording, beyond which the search is lost
PASSES = 100
SEEN = 3.0  # standard errors by which the first sample has to be off the orbit


@dataclass(frozen=True)
class Recalibration:
    """What one motion tells.

    Standard errors assume that the errors of the recorded signals are small, and independent from sample to sample and
    of each other. Slow ones (left-over dry friction, a controller with a wrong ratio, long sample periods) are not in
    them; `white` tells.

    Attributes:
        ratio: p3/p1 [1/s^2].
        level: E*/p1 [rad^2/s^2].
        rate: p4 gain, the decay of the invariant per action [s/rad^2].
        parameters: p1 [kg m^2], p3 [N m] and p4 [N m/V], in the unit of energy of target and gain.
        angle_noise, speed_noise: standard deviations of the errors [rad], [rad/s], as the misfit tells them apart.
        white: whether the misfit is independent from sample to sample; None where the speed was derived.
        dof: samples less parameters.
    """

    ratio: EstimatedValue
    level: EstimatedValue
    rate: EstimatedValue
    parameters: dict[str, EstimatedValue]
    angle_noise: float
    speed_noise: float
    white: bool | None
    dof: int


def recalibrate(motion: Motion, gain: float, target: float) -> Recalibration:
    """p1, p3 and p4 from a motion that energy control brings to its orbit, by Eq. 114 over the whole motion.

    Least squares with errors in both signals, whose variances the misfit itself tells: they are taken out of the
    squares and of the regressor, so that noise does not bias the ratio. One relation over the motion, not one over
    each step as in Eq. 118: the increments of a step are smaller than their noise.

    Args:
        gain: gamma of Eq. 109 [V s/(rad J)].
        target: E* of the controller [J].

    Raises:
        IdentificationError: gain or target is not positive, the motion is on its orbit from the start, or it does not
            approach one.
    """
    positive(gain=gain, target=target)
    fit = _fit(motion, _start(motion))
    ratio, level, rate, _ = fit.values
    if min(ratio, level, rate) <= 0:
        raise IdentificationError(
            "motion",
            f"ratio {ratio:.3g}, level {level:.3g}, rate {rate:.3g} are no approach to an orbit",
            "check signs, the equilibrium angle, and that energy control was on",
        )
    scale = target / level
    values = {"ratio": ratio, "level": level, "rate": rate, "p1": scale, "p3": ratio * scale, "p4": rate / gain}
    gradients = np.zeros((6, 4))
    gradients[:3, :3] = np.eye(3)
    gradients[3, 1] = -scale / level
    gradients[4, :2] = scale, -ratio * scale / level
    gradients[5, 2] = 1 / gain
    named = {
        name: with_interval(value, propagated(row, fit.covariance), fit.dof, UNITS[name])
        for (name, value), row in zip(values.items(), gradients, strict=True)
    }
    parameters = {name: named.pop(name) for name in ("p1", "p3", "p4")}
    angle_noise, speed_noise = (float(np.sqrt(variance)) for variance in fit.variances)
    return Recalibration(
        **named, parameters=parameters, angle_noise=angle_noise, speed_noise=speed_noise, white=fit.white, dof=fit.dof
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Values (4,) of ratio, level, rate and offset, their covariance (4, 4), and variances of angle and speed (2,)."""

    values: FloatArray
    covariance: FloatArray
    variances: FloatArray
    white: bool | None
    dof: int


def _start(motion: Motion) -> FloatArray:
    """(4,) the best over a grid of rates, the others by linear least squares."""
    height, kinetic = 1 - np.cos(motion.angle), 0.5 * motion.speed**2
    rated = []
    for rate in RATES / motion.action[-1]:
        decay = np.exp(-rate * motion.action)
        columns = np.column_stack([-height, np.ones_like(height), decay])
        ratio, level, offset = solution = np.linalg.lstsq(columns, kinetic, rcond=None)[0]
        rated.append((float(np.sum((kinetic - columns @ solution) ** 2)), [ratio, level, rate, offset]))
    return np.array(min(rated, key=lambda pair: pair[0])[1])


def _fit(motion: Motion, start: FloatArray) -> _Fit:
    """Newton's method on the corrected score of least squares: without what noise adds to it on average."""
    values, variances, dof = start, np.zeros(2), len(motion.time) - 4
    for _ in range(PASSES):
        line = _linearised(motion, values, variances)
        attenuation = np.diag([variances[0] * float(np.sum(np.sin(motion.angle) ** 2)), 0.0, 0.0, 0.0])
        inverse = np.linalg.pinv(line.slopes.T @ line.slopes - attenuation)
        step = -inverse @ (line.slopes.T @ line.error - attenuation @ values)
        values = values + step
        variances = _variances(motion, line, dof)
        if _lost(motion, values, variances):
            break
        if np.all(np.abs(step) <= 1e-9 * np.abs(values)):
            covariance = _covariance(motion, line, line.slopes @ inverse, variances)
            if abs(values[3]) < SEEN * np.sqrt(covariance[3, 3]):
                break
            white = whiteness([line.error]).white if motion.derivative is None else None
            return _Fit(values, covariance, variances, white, dof)
    raise IdentificationError(
        "motion",
        "its first samples cannot be told from its orbit, or it nears none",
        "start it off the orbit, under energy control",
    )


def _lost(motion: Motion, values: FloatArray, variances: FloatArray) -> bool:
    """Whether the rate has run away, or the errors are as large as the motion itself."""
    action = motion.action[-1]
    drowned = variances[0] > 1 or variances[1] * (motion.time[-1] - motion.time[0]) > 0.5 * action
    return bool(drowned or not 0 < values[2] * action < FASTEST)


@dataclass(frozen=True, eq=False)
class _Line:
    """Eq. 114 linearised.

    Attributes:
        error: (K,) how far samples are off, without what their noise makes of it on average [rad^2/s^2].
        by_angle, by_speed, by_action: (K,) its derivatives by the signals.
        slopes: (K, 4) its derivatives by ratio, level, rate and offset.
    """

    error: FloatArray
    by_angle: FloatArray
    by_speed: FloatArray
    by_action: FloatArray
    slopes: FloatArray


def _linearised(motion: Motion, values: FloatArray, variances: FloatArray) -> _Line:
    """Squares and cosines of noisy samples are off by their noise's variance on average, which is taken out."""
    ratio, level, rate, offset = values
    height = 1 - np.cos(motion.angle) * np.exp(variances[0] / 2)
    action = motion.action - variances[1] * (motion.time - motion.time[0])
    decay = np.exp(-rate * action)
    error = 0.5 * (motion.speed**2 - variances[1]) + ratio * height - level - offset * decay
    slopes = np.column_stack([height, -np.ones_like(height), offset * action * decay, -decay])
    return _Line(error, ratio * np.sin(motion.angle), motion.speed, rate * offset * decay, slopes)


def _variances(motion: Motion, line: _Line, dof: int) -> FloatArray:
    """(2,) variances of angle and speed that explain the squared errors best; a derived speed has the angle's."""
    squared = line.error**2 * len(line.error) / dof
    shares = np.column_stack([line.by_angle**2, line.by_speed**2])
    if motion.derivative is None:
        return np.asarray(nnls(shares, squared)[0])
    both = np.array([1.0, float(motion.derivative @ motion.derivative)])
    return np.asarray(squared.mean() / float((shares @ both).mean()) * both)


def _covariance(motion: Motion, line: _Line, influence: FloatArray, variances: FloatArray) -> FloatArray:
    """(n, n) from what each recorded sample's noise does to the values, given the errors' influence (K, n)."""
    later = np.cumsum((line.by_action[:, None] * influence)[::-1], axis=0)[::-1]
    from_angle = line.by_angle[:, None] * influence
    from_speed = line.by_speed[:, None] * (influence + 2 * np.gradient(motion.time)[:, None] * later)
    if motion.derivative is None:
        return np.asarray(variances[0] * from_angle.T @ from_angle + variances[1] * from_speed.T @ from_speed)
    through = np.column_stack([np.convolve(column, motion.derivative) for column in from_speed.T])
    through[HALF_WIDTH:-HALF_WIDTH] += from_angle
    return np.asarray(variances[0] * through.T @ through)
