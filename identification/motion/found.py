"""What one way of recalibration gives, whichever it is: balance, invariant, or as published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, with_interval
from identification.motion.balance import RATIOS, UNITS, Balance, Lumped, Values
from identification.motion.decay import recalibrate
from identification.motion.motion import Motion
from identification.motion.published import FACTOR, recalibrate_as_published

FOREIGN = 0.05  # of the voltage, rms, that a controller may be off before it counts as another one's


@dataclass(frozen=True)
class Orbit:
    """What an energy controller is set to: its model, gain [V s/(rad J)], amplitude [rad] and with it E* [J]."""

    model: Values
    gain: float
    amplitude: float
    target: float


@dataclass(frozen=True)
class Recalibrated:
    """What one way gave.

    Attributes:
        parameters: lumped parameter -> value and interval; unknown for one that is held, or of which there is none.
        ratios: what the motions tell whatever the unit of energy is [RATIOS].
        remarks: sentences that a reader of the figures must know.
    """

    parameters: Mapping[Lumped, EstimatedValue]
    ratios: Mapping[str, EstimatedValue]
    remarks: tuple[str, ...] = ()

    @property
    def values(self) -> dict[Lumped, float]:
        """Lumped parameter -> value [UNITS]."""
        return {name: one.value for name, one in self.parameters.items()}


def by_balance(balance: Balance, held: Lumped) -> Recalibrated:
    """What the energy balance gave; the held parameter has no interval."""
    kept = with_interval(balance.values[held], inf, unit=UNITS[held])
    order = [name for name in UNITS if name == held or name in balance.parameters]
    remark = f"a motion tells its parameters only up to a common factor: {held} is held at {kept.value:.6g} {kept.unit}"
    return Recalibrated(
        {name: balance.parameters.get(name, kept) for name in order}, balance.ratios, (remark, *balance.indistinct)
    )


def by_invariant(motions: Sequence[Motion], orbit: Orbit) -> Recalibrated:
    """Eq. 114 over each motion, their estimates weighed by their precision.

    Raises:
        IdentificationError: a motion is on its orbit from the start, does not approach one, or was not brought about
            by this controller.
    """
    _check_controller(motions, orbit)
    each = [recalibrate(motion, orbit.gain, orbit.target) for motion in motions]
    names: tuple[Lumped, ...] = ("p1", "p3", "p4")
    parameters = {name: _pooled([one.parameters[name] for one in each]) for name in names}
    remark = (
        "p1, p3 and p4 are in the controller's unit of energy: only p3/p1 and p4/p1 are the plant's; friction that "
        "Eq. 103 leaves over is in p1 and p3"
    )
    ratios = {"p3/p1": _pooled([one.ratio for one in each])}
    return Recalibrated(parameters, ratios, (remark,))


def as_published(motions: Sequence[Motion], orbit: Orbit) -> Recalibrated:
    """Eq. 118 over all motions; without intervals.

    Raises:
        IdentificationError: the motions were not brought about by this controller.
    """
    _check_controller(motions, orbit)
    names: tuple[Lumped, ...] = ("p1", "p3", "p4")
    start = np.array([orbit.model[name] for name in names])
    found = recalibrate_as_published(motions, orbit.gain, orbit.target, start)
    at_bounds = [
        name
        for name, value, begin in zip(names, found, start, strict=True)
        if not 1.001 / FACTOR < value / begin < FACTOR / 1.001
    ]
    remarks = ["Eq. 118 is 0 for p1 = p3 = p4 = 0, too, and noise pulls towards that: it has no honest intervals"]
    if at_bounds:
        remarks.append(f"{', '.join(at_bounds)} ended at the bounds, {FACTOR:g} times from the generic model")
    parameters = {
        name: with_interval(float(value), inf, unit=UNITS[name]) for name, value in zip(names, found, strict=True)
    }
    ratio = with_interval(float(found[1] / found[0]), inf, unit=RATIOS["p3/p1"])
    return Recalibrated(parameters, {"p3/p1": ratio}, tuple(remarks))


def _pooled(values: Sequence[EstimatedValue]) -> EstimatedValue:
    """The mean weighed by precision."""
    weights = np.array([one.std**-2 for one in values])
    mean = float(weights @ [one.value for one in values] / weights.sum())
    return with_interval(mean, float(weights.sum() ** -0.5), unit=values[0].unit)


def _check_controller(motions: Sequence[Motion], orbit: Orbit) -> None:
    """See that the recorded voltages, where there are some, are what the controller says (Eqs. 103 and 109)."""
    for motion in motions:
        if motion.voltage is None:
            continue
        own, model = motion.speed, orbit.model
        error = motion.invariant(model["p1"], model["p3"], orbit.target)
        expected = model["p2"] / model["p4"] * own - orbit.gain * own * error
        off = float(np.sqrt(np.mean((motion.voltage - expected) ** 2) / np.mean(motion.voltage**2)))
        if off > FOREIGN:
            raise IdentificationError(
                motion.name,
                f"its voltage is {off:.0%} off what the study's controller says: another one made the motion",
                "give the controller of the recordings, or `take: balance`, which needs none",
            )
