"""A pendulum under sampled energy control (Eqs. 103, 109), many draws of its sensors' noise at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from orchestrator.trace import FloatArray, Trace

RIG = {"p1": 4.0957e-3, "p2": 1.8e-4, "p3": 0.15832, "p4": 2.466}
GENERIC = {"p1": 4.36e-3, "p2": 1.8e-4, "p3": 0.1425, "p4": 2.96}
SMOOTH = 0.05  # speed over which dry friction changes sign [rad/s]


@dataclass(frozen=True)
class Swing:
    """What swings, what controls it, and what is measured.

    Attributes:
        rig, model: p1 to p4 of the plant, and of the controller's model.
        dry: dry friction at positive and at negative speed [N m].
        noise: of angle [rad] and speed [rad/s], as measured, recorded and controlled by.
    """

    rig: Mapping[str, float] = field(default_factory=lambda: RIG)
    model: Mapping[str, float] = field(default_factory=lambda: GENERIC)
    dry: tuple[float, float] = (0.0, 0.0)
    gain: float = 0.03
    amplitude: float = 1.0
    start: float = 0.6
    noise: tuple[float, float] = (0.0, 0.0)
    duration: float = 12.0
    step: float = 0.005

    @property
    def target(self) -> float:
        """E* of the controller [J]."""
        return self.model["p3"] * (1 - float(np.cos(self.amplitude)))

    def voltage(self, angle: FloatArray, speed: FloatArray) -> FloatArray:
        """Eqs. 103, 105 and 109."""
        energy = 0.5 * self.model["p1"] * speed**2 + self.model["p3"] * (1 - np.cos(angle))
        return self.model["p2"] / self.model["p4"] * speed - self.gain * speed * (energy - self.target)

    def rates(self, state: FloatArray, voltage: FloatArray) -> FloatArray:
        """(2, N) derivatives of angle and speed."""
        sign = np.tanh(state[1] / SMOOTH)
        dry = 0.5 * (self.dry[0] * (1 + sign) + self.dry[1] * (1 - sign)) * sign
        torque = self.rig["p4"] * voltage - self.rig["p2"] * state[1] - dry - self.rig["p3"] * np.sin(state[0])
        return np.array([state[1], torque / self.rig["p1"]])

    def recorded(self, draws: int = 1, seed: int = 0) -> list[Trace]:
        """A trace of angle, speed and held voltage a draw, by a Runge-Kutta method of fourth order."""
        rng, count = np.random.default_rng(seed), round(self.duration / self.step)
        state = np.array([np.full(draws, self.start), np.zeros(draws)])
        rows = np.empty((count, 3, draws))
        for k in range(count):
            measured = state + np.array(self.noise)[:, None] * rng.standard_normal((2, draws))
            voltage = self.voltage(measured[0], measured[1])
            rows[k] = *measured, voltage
            state = self._stepped(state, voltage, self.step)
        time = self.step * np.arange(count)
        return [
            Trace(time, {"angle": rows[:, 0, n], "speed": rows[:, 1, n], "voltage": rows[:, 2, n]}, name=f"draw {n}")
            for n in range(draws)
        ]

    def _stepped(self, state: FloatArray, voltage: FloatArray, h: float) -> FloatArray:
        k1 = self.rates(state, voltage)
        k2 = self.rates(state + 0.5 * h * k1, voltage)
        k3 = self.rates(state + 0.5 * h * k2, voltage)
        k4 = self.rates(state + h * k3, voltage)
        return np.asarray(state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
