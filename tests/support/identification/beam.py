"""The flexible arm by other means than the model's: finite elements for its modes, quadrature for its mass matrix."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

from orchestrator.trace import FloatArray

MODES = 5


@dataclass(frozen=True)
class Arm:
    """Physical constants of the arm, by the names of the model's parameters."""

    bending_stiffness: float = 7.906
    mass_per_length: float = 0.4131
    length: float = 1.0
    hub_inertia: float = 0.003
    tip_fixture: float = 0.02
    payload: float = 0.0


def element(arm: Arm, size: float) -> tuple[FloatArray, FloatArray]:
    """Mass and stiffness of one Euler-Bernoulli element with cubic shapes; (w, slope) at either end."""
    h = size
    mass = [
        [156, 22 * h, 54, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54, 13 * h, 156, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]
    stiffness = [
        [12, 6 * h, -12, 6 * h],
        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12, -6 * h, 12, -6 * h],
        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ]
    return arm.mass_per_length * h / 420 * np.array(mass), arm.bending_stiffness / h**3 * np.array(stiffness)


def finite_element_modes(arm: Arm, count: int, elements: int = 60) -> FloatArray:
    """(count,) frequencies [Hz] of the free arm above its rigid one: hub pinned, tip free."""
    size = 2 * (elements + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for i in range(elements):
        at = slice(2 * i, 2 * i + 4)
        m, k = element(arm, arm.length / elements)
        mass[at, at] += m
        stiffness[at, at] += k
    mass[1, 1] += arm.hub_inertia
    mass[-2, -2] += arm.tip_fixture + arm.payload
    squares = eigh(stiffness[1:, 1:], mass[1:, 1:], eigvals_only=True, subset_by_index=[0, count])
    return np.sqrt(squares[1:]) / (2 * math.pi)


def roots() -> FloatArray:
    """(MODES,) solutions of cos b cosh b = -1."""
    brackets = [((i + 0.5) * math.pi - 0.4, (i + 0.5) * math.pi + 0.4) for i in range(MODES)]
    return np.array([brentq(lambda b: math.cos(b) + 1 / math.cosh(b), *bracket, xtol=1e-14) for bracket in brackets])


def shapes(xi: FloatArray, derivative: int = 0) -> FloatArray:
    """(MODES, K) modes of the clamped-free beam at x/L = xi, or their second derivatives."""
    b = roots()[:, None]
    sigma = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    z, sign = b * xi, 1 if derivative else -1
    return b**derivative * (np.cosh(z) + sign * np.cos(z) - sigma * (np.sinh(z) + sign * np.sin(z)))


def matrices(arm: Arm) -> tuple[FloatArray, FloatArray]:
    """Mass and stiffness over (hub angle, modes), the integrals by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    xi, weights = 0.5 * (nodes + 1), 0.5 * weights
    moved = np.vstack([arm.length * xi, shapes(xi)])
    tip = np.concatenate([[arm.length], shapes(np.array([1.0]))[:, 0]])
    mass = arm.mass_per_length * arm.length * (moved * weights) @ moved.T
    mass += (arm.tip_fixture + arm.payload) * np.outer(tip, tip)
    mass[0, 0] += arm.hub_inertia
    bent = shapes(xi, 2)
    stiffness = np.zeros_like(mass)
    stiffness[1:, 1:] = arm.bending_stiffness / arm.length**3 * (bent * weights) @ bent.T
    return mass, stiffness


def energy(arm: Arm, coordinates: FloatArray, rates: FloatArray) -> FloatArray:
    """(K,) kinetic and elastic energy [J] of coordinates and rates (K, 1 + MODES)."""
    mass, stiffness = matrices(arm)
    kinetic = np.einsum("ki,ij,kj->k", rates, mass, rates)
    return 0.5 * (kinetic + np.einsum("ki,ij,kj->k", coordinates, stiffness, coordinates))


def lugre(arm: Arm, ratios: Any, torque: float, friction: dict[str, float]) -> Any:
    """f(t, x) of the arm with LuGre's friction as published; x is coordinates, rates and the bristles' deflection."""
    mass, stiffness = matrices(arm)
    inverse = np.linalg.inv(mass)
    dampers = np.zeros(MODES + 1)
    dampers[1:] = 2 * np.array(ratios) * np.sqrt(np.diag(stiffness)[1:] * arm.mass_per_length * arm.length)

    def rates(t: float, x: FloatArray) -> FloatArray:
        q, v, z = x[: MODES + 1], x[MODES + 1 : -1], x[-1]
        bristle = v[0] - friction["s0"] * abs(v[0]) * z / friction["Tc"]
        damping = friction["s1"] * math.exp(-((v[0] / friction["vs"]) ** 2))
        forces = -stiffness @ q - dampers * v
        forces[0] += torque - friction["s0"] * z - damping * bristle - friction["c"] * v[0]
        return np.concatenate([v, inverse @ forces, [bristle]])

    return rates
