"""The energy balance of a motion whose voltage was recorded: p1 to p4 but for a common factor, whatever controls it.

Eq. 5 times the speed, integrated from the start of a stretch, over p1:

    w^2/2 + p3/p1 (1 - cos theta) = p4/p1 W - p2/p1 S - dry+/p1 L+ - dry-/p1 L- + level

with W the integral of v w, S that of w^2, and L+ and L- the ways there and back. Under energy control with the right
ratio p3/p1, without dry friction, this is Eq. 114. It needs no controller's model, no right compensation of friction
and no energy E*; but all its terms are in one unit of energy, so that the parameters are told apart only up to a common
factor: one of them is held. On the orbit itself the energy stays, and W, S and L grow together: there only p3/p1 and
friction over p4 are seen, and p4/p1 comes from the approach.

The thesis' model has no dry friction. It is regressed all the same, as it would spoil p4 and p3, and folded into p2
where nothing takes it: the viscous friction that takes as much energy on this motion. So p2 describes the motion and
its neighbourhood, not the body. What the balance leaves out (play) is in none of the intervals that come from the
sensors' noise; those from stretches are what other stretches of such motions would give.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, propagated, with_interval
from identification.motion.motion import Motion
from identification.motion.stretches import (
    BACK,
    GRAVITY,
    MOTOR,
    THERE,
    VISCOUS,
    Stretch,
    covariance_of_noise,
    covariance_of_stretches,
    explained_by_noise,
    normal_equations,
    solved,
    stretches_of,
)
from orchestrator.trace import FloatArray, ReadOnlyArrays

Lumped = Literal["p1", "p2", "p3", "p4", "dry_positive", "dry_negative"]
Values = Mapping[Lumped, float]
UNITS: dict[Lumped, str] = {
    "p1": "kg m^2",
    "p2": "N m s/rad",
    "p3": "N m",
    "p4": "N m/V",
    "dry_positive": "N m",
    "dry_negative": "N m",
}
RATIOS = {"p3/p1": "1/s^2", "p4/p1": "1/(V s^2)", "p2/p4": "V s/rad"}
PER_INERTIA: tuple[Lumped, ...] = ("p2", "p3", "p4", "dry_positive", "dry_negative")  # the columns, each over p1
BLURRED = 0.5  # relative standard error from which a direction counts as not seen
MIXED = 0.3  # share of a direction from which a parameter is part of it


@dataclass(frozen=True, eq=False)
class Balance(ReadOnlyArrays):
    """What the energy balance of some motions tells.

    Attributes:
        values: of all parameters, the held one at its generic value [UNITS].
        parameters: the others with their intervals; unknown where the motions cannot tell them apart.
        ratios: what the motions tell whatever is held [RATIOS].
        indistinct: sentences about what the motions cannot tell apart.
        method: what the intervals come from: the sensors' noise where that explains the misfit, else how much the
            stretches differ.
        errors: (K_w,) a stretch, what the balance leaves over [rad^2/s^2].
        times: (K_w,) a stretch [s].
        recordings: name of the recording of each stretch.
    """

    values: Values
    parameters: Mapping[Lumped, EstimatedValue]
    ratios: Mapping[str, EstimatedValue]
    indistinct: tuple[str, ...]
    method: Literal["noise", "stretches"]
    errors: tuple[FloatArray, ...]
    times: tuple[FloatArray, ...]
    recordings: tuple[str, ...]


def energy_balance(
    motions: Sequence[Motion], generic: Values, held: Lumped = "p4", dry_friction: bool = False
) -> Balance:
    """p1 to p4 from motions whose voltage was recorded.

    A direction in which the motions hardly move the misfit keeps what the generic model has.

    Args:
        generic: the model to be recalibrated; dry friction that it does not name is 0 there.
        held: the one that is known.
        dry_friction: whether dry friction stays apart; else it is folded into p2.

    Raises:
        IdentificationError: a motion has no voltage or no period, or the balance has no solution of the right signs.
    """
    stretches = [stretch for motion in motions for stretch in stretches_of(motion)]
    normal, right = normal_equations(stretches)
    found = solved(normal, right)
    white = explained_by_noise(stretches, found)
    covariance = covariance_of_noise(stretches, found, normal) if white else covariance_of_stretches(stretches)
    start = np.array([generic.get(name, 0.0) / generic["p1"] for name in PER_INERTIA])
    known = _Known.of(covariance, inf if white else len(stretches) - 1, _scales(stretches, start))
    if known.blurred.size:
        seen = known.scales[:, None] * known.seen
        found = start + seen @ solved(seen.T @ normal @ seen, seen.T @ (right - normal @ start))
    fold = np.eye(5) if dry_friction else _fold(stretches)
    told = fold @ found
    _check(told)
    names = [name for name in UNITS if dry_friction or not name.startswith("dry")]
    ratios = {name: _ratio(f"{name}/{held}", told, generic[held]) for name in names}
    return Balance(
        {name: value for name, (value, _) in ratios.items()},
        {name: known.estimate(*ratio, fold, UNITS[name]) for name, ratio in ratios.items() if name != held},
        {name: known.estimate(*_ratio(name, told), fold, unit) for name, unit in RATIOS.items()},
        known.sentences(fold),
        "noise" if white else "stretches",
        tuple(stretch.error(found) for stretch in stretches),
        tuple(stretch.motion.time[stretch.rows] for stretch in stretches),
        tuple(stretch.motion.name for stretch in stretches),
    )


def _scales(stretches: Sequence[Stretch], start: FloatArray) -> FloatArray:
    """(5,) the generic values; of friction at least what takes as much energy as the generic motor gives."""
    sizes = np.sqrt(np.sum([np.sum(stretch.terms**2, axis=0) for stretch in stretches], axis=0))
    scales = np.abs(start)
    for column in (VISCOUS, THERE, BACK):
        scales[column] = max(scales[column], scales[MOTOR] * sizes[MOTOR] / sizes[column])
    return scales


def _fold(stretches: Sequence[Stretch]) -> FloatArray:
    """(5, 5) what moves dry friction into p2: as much as takes the same energy over the motions."""
    spans = np.sum([np.ptp(stretch.terms, axis=0) for stretch in stretches], axis=0)
    fold = np.diag([1.0, 1.0, 1.0, 0.0, 0.0])
    fold[VISCOUS, [THERE, BACK]] = spans[[THERE, BACK]] / spans[VISCOUS]
    return fold


@dataclass(frozen=True, eq=False)
class _Known(ReadOnlyArrays):
    """What is known of the five columns' coefficients, in directions of relative changes.

    Attributes:
        covariance: (5, 5) of the coefficients over `scales`, without the blurred directions.
        freedom: degrees of freedom of the intervals.
        scales: (5,) one relative unit.
        seen: (5, k) directions that are known better than `BLURRED`.
        blurred: (5, 5 - k) those that are not.
    """

    covariance: FloatArray
    freedom: float
    scales: FloatArray
    seen: FloatArray
    blurred: FloatArray

    @classmethod
    def of(cls, covariance: FloatArray, freedom: float, scales: FloatArray) -> _Known:
        """By the principal directions of the relative covariance; where that is not known all count as seen."""
        relative = covariance / np.outer(scales, scales)
        if not np.all(np.isfinite(relative)):
            return cls(relative, freedom, scales, np.eye(5), np.zeros((5, 0)))
        variances, directions = np.linalg.eigh(relative)
        known = variances <= BLURRED**2
        seen = directions[:, known]
        return cls(seen * variances[known] @ seen.T, freedom, scales, seen, directions[:, ~known])

    def estimate(self, value: float, gradient: FloatArray, fold: FloatArray, unit: str) -> EstimatedValue:
        """A function of the folded coefficients with this gradient (5,); unknown where it moves along a blurred
        direction, or nothing is known."""
        relative = (fold.T @ gradient) * self.scales
        lost = np.linalg.norm(self.blurred.T @ relative) > MIXED * np.linalg.norm(relative)
        if lost or not np.all(np.isfinite(self.covariance)):
            return with_interval(value, inf, unit=unit)
        return with_interval(value, propagated(relative, self.covariance), self.freedom, unit)

    def sentences(self, fold: FloatArray) -> tuple[str, ...]:
        """One a blurred direction that is left when dry friction is folded: what it mixes, and what to do."""
        said = []
        for direction in (fold @ (self.scales[:, None] * self.blurred)).T:
            shares = np.abs(direction / self.scales)
            mixed = [f"{name}/p1" for name, share in zip(PER_INERTIA, shares, strict=True) if share > MIXED]
            if mixed:
                what = f"{' and '.join(mixed)} apart" if len(mixed) > 1 else f"{mixed[0]} at all"
                said.append(
                    f"the motions do not tell {what}: along that direction the generic model is kept; "
                    "record approaches to the orbit from farther off"
                )
        return tuple(said)


def _check(told: FloatArray) -> None:
    if not (told[GRAVITY] > 0 and told[MOTOR] > 0):
        raise IdentificationError(
            "motion",
            f"p3/p1 = {told[GRAVITY]:.3g} and p4/p1 = {told[MOTOR]:.3g} are no pendulum's",
            "check the signs of angle, speed and voltage, and the equilibrium angle",
        )


def _ratio(name: str, told: FloatArray, factor: float = 1.0) -> tuple[float, FloatArray]:
    """`factor` times a ratio such as "p3/p1", and its gradient (5,) by the coefficients."""
    upper, lower = name.split("/")
    over: dict[str, float] = {"p1": 1.0, **dict(zip(PER_INERTIA, map(float, told), strict=True))}
    of_upper, of_lower = (np.array([float(other == one) for other in PER_INERTIA]) for one in (upper, lower))
    value = over[upper] / over[lower]
    return factor * value, factor * (of_upper - value * of_lower) / over[lower]
