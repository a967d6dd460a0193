"""The regression behind the energy balance: motions cut into stretches, their normal equations, and covariances.

A stretch is some periods of a motion, whose start energy is of its own: slow errors of the balance stay in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import comb, inf

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.validation import whiteness
from identification.motion.motion import Motion
from orchestrator.trace import FloatArray, ReadOnlyArrays

PERIODS = 2.0  # of a stretch
FEWEST = 8  # stretches that tell how much they differ
ORDER = 6  # of the differences that show a sensor's noise
VISCOUS, GRAVITY, MOTOR, THERE, BACK = range(5)  # columns: p2, p3, p4 and dry friction by direction, each over p1


@dataclass(frozen=True)
class MotionNoise:
    """Standard deviations of a motion's angle [rad] and speed [rad/s], sample by sample."""

    angle: float
    speed: float


@dataclass(frozen=True, eq=False)
class Stretch(ReadOnlyArrays):
    """A part of a motion, its columns less their means: what its start energy could be is then out of the balance.

    Attributes:
        motion: what it is part of, and that one's noise.
        rows: of the motion.
        terms: (K, 5) what p2, p3, p4 and dry friction, each over p1, are multiplied by.
        kinetic: (K,) half of the squared speed.
        attenuation: what the angle's noise adds to the square of the column of p3.
    """

    motion: Motion
    noise: MotionNoise
    rows: slice
    terms: FloatArray
    kinetic: FloatArray
    attenuation: float

    def error(self, found: FloatArray) -> FloatArray:
        """(K,) what the balance leaves over [rad^2/s^2]."""
        return np.asarray(self.kinetic - self.terms @ found)


def sensor_noise(motion: Motion) -> MotionNoise:
    """By differences of a high order, which a swing has almost none of; what it has counts as noise."""
    angle = _roughness(motion.angle)
    if motion.derivative is not None:
        return MotionNoise(angle, angle * float(np.linalg.norm(motion.derivative)))
    return MotionNoise(angle, _roughness(motion.speed))


def _roughness(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.diff(values, ORDER) ** 2) / comb(2 * ORDER, ORDER)))


def stretches_of(motion: Motion) -> list[Stretch]:
    """The motion in stretches of `PERIODS`, the last one with what is left.

    Raises:
        IdentificationError: it has no voltage, or does not swing.
    """
    noise, terms, kinetic = sensor_noise(motion), _terms(motion), 0.5 * motion.speed**2
    length = PERIODS * motion.period
    count = max(1, int((motion.time[-1] - motion.time[0]) / length))
    inner = np.searchsorted(motion.time, motion.time[0] + length * np.arange(1, count))
    ends = [0, *map(int, inner), len(motion.time)]
    rows = [slice(first, last) for first, last in pairwise(ends)]
    return [
        Stretch(
            motion,
            noise,
            row,
            terms[row] - terms[row].mean(axis=0),
            kinetic[row] - kinetic[row].mean(),
            noise.angle**2 * float(np.sum(np.sin(motion.angle[row]) ** 2)),
        )
        for row in rows
    ]


def _terms(motion: Motion) -> FloatArray:
    """(K, 5) the columns, without what the sensors' noise adds to them on average."""
    if motion.work is None:
        raise IdentificationError(motion.name, "holds no voltage", "record the command, or take the invariant")
    noise = sensor_noise(motion)
    height = 1 - np.cos(motion.angle) * np.exp(noise.angle**2 / 2)
    action = motion.action - noise.speed**2 * (motion.time - motion.time[0])
    ways = [np.concatenate([[0.0], np.cumsum(np.maximum(sign * np.diff(motion.angle), 0.0))]) for sign in (1, -1)]
    return np.column_stack([-action, -height, motion.work, -ways[0], -ways[1]])


def normal_equations(stretches: Sequence[Stretch]) -> tuple[FloatArray, FloatArray]:
    """(5, 5) and (5,) the normal equations, without what noise adds to them on average."""
    normal = np.sum([stretch.terms.T @ stretch.terms for stretch in stretches], axis=0)
    normal[GRAVITY, GRAVITY] -= sum(stretch.attenuation for stretch in stretches)
    return normal, np.sum([stretch.terms.T @ stretch.kinetic for stretch in stretches], axis=0)


def solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """(5,) the solution; the smallest one where there are several. Columns are scaled to be of one size first."""
    sizes = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    return np.asarray(np.linalg.lstsq(normal / np.outer(sizes, sizes), right / sizes, rcond=1e-14)[0] / sizes)


def explained_by_noise(stretches: Sequence[Stretch], found: FloatArray) -> bool:
    """Whether the misfit over what the sensors' noise makes of it is independent from sample to sample."""
    if any(stretch.motion.derivative is not None for stretch in stretches):
        return False
    scaled = []
    for stretch in stretches:
        motion, noise = stretch.motion, stretch.noise
        by_angle, by_speed = found[GRAVITY] * np.sin(motion.angle[stretch.rows]), motion.speed[stretch.rows]
        spread = np.sqrt((by_angle * noise.angle) ** 2 + (by_speed * noise.speed) ** 2)
        if not np.all(spread > 0):
            return False
        error = stretch.error(found)
        level = float(np.average(error, weights=spread**-2))  # far better known than the mean that the fit takes out
        scaled.append((error - level) / spread)
    return whiteness(scaled).white


def covariance_of_noise(stretches: Sequence[Stretch], found: FloatArray, normal: FloatArray) -> FloatArray:
    """(5, 5) from what each recorded sample's noise does, at once and through the integrals after it."""
    inverse, total = np.linalg.pinv(normal), np.zeros((5, 5))
    for motion, own in _by_motion(stretches):
        noise, influence = own[0].noise, np.zeros((len(motion.time), 5))
        for stretch in own:
            influence[stretch.rows] = stretch.terms @ inverse
        by_angle, by_speed = _effects(motion, found, influence)
        total += noise.angle**2 * by_angle.T @ by_angle + noise.speed**2 * by_speed.T @ by_speed
    return total


def _effects(motion: Motion, found: FloatArray, influence: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K, 5) twice: what an error of each angle and of each speed does to the five, given the misfit's influence."""
    assert motion.voltage is not None
    later = np.cumsum(influence[::-1], axis=0)[::-1]
    after = np.vstack([later[1:], np.zeros(5)])
    before = np.concatenate([[0.0], motion.voltage[:-1]])
    by_work = before[:, None] * influence + (before - motion.voltage)[:, None] * after
    at_once = found[GRAVITY] * np.sin(motion.angle) + np.where(motion.speed > 0, found[THERE], -found[BACK])
    by_angle = at_once[:, None] * influence - found[MOTOR] * by_work
    step = np.gradient(motion.time)[:, None]
    return by_angle, motion.speed[:, None] * (influence + 2 * found[VISCOUS] * step * later)


def _by_motion(stretches: Sequence[Stretch]) -> Iterator[tuple[Motion, list[Stretch]]]:
    for motion in {id(stretch.motion): stretch.motion for stretch in stretches}.values():
        yield motion, [stretch for stretch in stretches if stretch.motion is motion]


def covariance_of_stretches(stretches: Sequence[Stretch]) -> FloatArray:
    """(5, 5) the delete-one-stretch jackknife; infinite with few stretches."""
    count = len(stretches)
    if count < FEWEST:
        return np.full((5, 5), inf)
    normal, right = normal_equations(stretches)
    without = []
    for stretch in stretches:
        own_normal, own_right = normal_equations([stretch])
        without.append(solved(normal - own_normal, right - own_right))
    spread = np.array(without) - np.mean(without, axis=0)
    return np.asarray(spread.T @ spread * (count - 1) / count)
