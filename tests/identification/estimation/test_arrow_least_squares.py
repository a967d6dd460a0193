"""The search for a minimum: which points it takes, and what robust losses make of outliers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from identification.estimation.arrow_least_squares import (
    Box,
    Limits,
    Loss,
    LossKind,
    Minimum,
    Point,
    WindowBlock,
    evaluated,
    minimise,
)
from orchestrator.trace import FloatArray


@dataclass
class Bent:
    """One residual of one parameter, 1 - x - bend x^2: the linear model promises a residual of 0 at x = 1."""

    bend: float
    tried: list[float] = field(default_factory=list)

    def residuals(self, point: Point) -> list[FloatArray] | None:
        (x,) = point.parameters
        self.tried.append(float(x))
        return [np.array([1 - x - self.bend * x**2])]

    def linearise(self, point: Point, residuals: list[FloatArray]) -> list[WindowBlock]:
        (x,) = point.parameters
        return [WindowBlock(residuals[0], np.array([[-1 - 2 * self.bend * x]]), np.zeros((1, 0)))]


def at(x: float) -> Point:
    return Point(np.array([x]), np.zeros((1, 0)))


def one_step(system: Bent) -> Minimum:
    start = evaluated(system, at(0.0), Loss())
    assert start is not None
    box = Box(at(-10.0), at(10.0))
    return minimise(system, start, box, Loss(), limits=Limits(iterations=1), report=lambda iteration, cost: None)


@pytest.mark.parametrize("share", [0.1, 0.01, 0.001])
def test_a_point_that_is_better_by_little_of_what_was_promised_is_taken_at_once(share: float) -> None:
    """Any real fall of the cost counts: shorter steps would cost a free run each, and reach less far."""
    system = Bent(bend=float(np.sqrt(1 - share)))
    found = one_step(system)
    assert len(system.tried) == 2
    assert found.at.point.parameters == pytest.approx([1.0], abs=2e-3)


def test_a_point_that_is_worse_is_not_taken() -> None:
    found = one_step(Bent(bend=1.5))
    assert found.at.cost < 0.5 and found.at.point.parameters[0] < 0.9


RESIDUALS = np.array([0.0, 0.3, -0.9, 1.1, -4.0, 30.0, 1e4])


@pytest.mark.parametrize("kind", ["linear", "soft_l1", "huber", "cauchy"])
def test_a_scaled_block_has_the_gradient_of_the_loss_and_never_less_than_a_tenth_of_its_weight(kind: LossKind) -> None:
    """An outlier's own curvature vanishes or is negative: without a floor steps would be endless, or lead uphill."""
    loss, slopes = Loss(kind, 0.7), np.linspace(1, 2, len(RESIDUALS))
    scaled = loss.scaled(WindowBlock(RESIDUALS, slopes[:, None], np.zeros((len(RESIDUALS), 0))))
    rows = scaled.parameters[:, 0]
    np.testing.assert_allclose(rows * scaled.residual, slopes * loss.influence(RESIDUALS), rtol=1e-12)
    weight = np.divide(loss.influence(RESIDUALS), RESIDUALS, out=np.ones_like(RESIDUALS), where=RESIDUALS != 0)
    curvature = (rows / slopes) ** 2
    np.testing.assert_allclose(curvature, np.maximum(loss.curvature(RESIDUALS), 0.1 * weight), rtol=1e-12)
    assert np.all(curvature >= 0.1 * weight * (1 - 1e-12)) and np.all(curvature > 0)
