"""The linearised pendulum behind a zero-order hold, in closed form both ways (pendulum thesis, Lemma 4).

Identified discrete models become psi, w_n and gain again through the inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fmus.errors import IdentificationError


@dataclass(frozen=True)
class DiscreteModel:
    """y[k+2] + a1 y[k+1] + a0 y[k] = b1 u[k+1] + b0 u[k] (Eq. 46), sampled every `period` [s].

    a0, a1 are numbers; b0, b1 are in [output unit / input unit].
    """

    a0: float
    a1: float
    b0: float
    b1: float
    period: float


@dataclass(frozen=True)
class ContinuousModel:
    """y'' + 2 psi w_n y' + w_n^2 y = gain w_n^2 u (Eqs. 51 and 53).

    Attributes:
        damping_ratio: psi, between 0 and 1.
        natural_frequency: w_n [rad/s].
        gain: at rest, gamma [output unit / input unit].
    """

    damping_ratio: float
    natural_frequency: float
    gain: float

    @property
    def friction_per_inertia(self) -> float:
        """p2 / p1 [1/s]."""
        return 2 * self.damping_ratio * self.natural_frequency

    @property
    def stiffness_per_inertia(self) -> float:
        """p3 / p1 [1/s^2]."""
        return self.natural_frequency**2

    @property
    def input_per_inertia(self) -> float:
        """p4 / p1 [output unit / (input unit s^2)]."""
        return self.gain * self.natural_frequency**2


def continuous_from_parameters(p1: float, p2: float, p3: float, p4: float) -> ContinuousModel:
    """psi, w_n and gamma of p1 a + p2 w + p3 q = p4 v (Eq. 51).

    Args:
        p1, p2, p3, p4: [kg m^2], [N m s/rad], [N m], [N m / input unit]; only their ratios matter.

    Raises:
        IdentificationError: not underdamped (Eq. 45).
    """
    if not (p1 > 0 and p3 > 0 and 0 < p2 < 2 * math.sqrt(p1 * p3)):
        raise IdentificationError(
            "discretisation",
            f"p1 = {p1:g}, p2 = {p2:g}, p3 = {p3:g} is not an underdamped system",
            "Eqs. 47-50 need 0 < p2 < 2 sqrt(p1 p3)",
        )
    return ContinuousModel(p2 / (2 * math.sqrt(p1 * p3)), math.sqrt(p3 / p1), p4 / p3)


def discretised(model: ContinuousModel, period: float) -> DiscreteModel:
    """The zero-order-hold equivalent for a sampling period [s] (Eqs. 47-50).

    Raises:
        IdentificationError: not underdamped, or the period is not positive.
    """
    psi, omega = model.damping_ratio, model.natural_frequency
    if not (0 < psi < 1 and omega > 0 and period > 0):
        raise IdentificationError(
            "discretisation",
            f"psi = {psi:g}, w_n = {omega:g}, period = {period:g} s has no such form",
            "Eqs. 47-50 need 0 < psi < 1 and a positive frequency and period",
        )
    root = math.sqrt(1 - psi**2)
    decay, angle, beta = math.exp(-period * psi * omega), period * omega * root, math.acos(psi)
    return DiscreteModel(
        a0=decay**2,
        a1=-2 * decay * math.cos(angle),
        b0=model.gain * (decay**2 + decay / root * math.sin(angle - beta)),
        b1=model.gain * (1 - decay / root * math.sin(angle + beta)),
        period=period,
    )


def continuous_from_discrete(model: DiscreteModel) -> ContinuousModel:
    """The underdamped continuous system whose zero-order-hold equivalent this is; inverse of `discretised`.

    The slowest such system is given, with a damped frequency below pi / period; faster ones alias onto it.
    The gain is that at rest, (b0 + b1) / (1 + a0 + a1).

    Raises:
        IdentificationError: the eigenvalues are real, or not inside the unit circle.
    """
    if not (0 < model.a0 < 1 and model.a1**2 < 4 * model.a0 and model.period > 0):
        raise IdentificationError(
            "discretisation",
            f"z^2 + {model.a1:g} z + {model.a0:g} has no decaying complex pair of roots",
            "an underdamped continuous system gives 0 < a0 < 1 and a1^2 < 4 a0",
        )
    decay_rate = -math.log(model.a0) / 2
    angle = math.acos(-model.a1 / (2 * math.sqrt(model.a0)))
    radius = math.hypot(decay_rate, angle)
    gain = (model.b0 + model.b1) / (1 + model.a0 + model.a1)
    return ContinuousModel(decay_rate / radius, radius / model.period, gain)
