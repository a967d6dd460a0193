"""Simulators with known answers, cheap enough to be fitted hundreds of times."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fmus.errors import FmuError
from orchestrator.trace import FloatArray

INSTANTS = np.linspace(0.0, 4.0, 81)


def oscillation(values: Mapping[str, float], time: FloatArray) -> FloatArray:
    """(K, 1) free decay of x'' + 2 d x' + k x = 0 from (x0, v0), in closed form; k > d^2."""
    d, k = values["rig.damping"], values["rig.stiffness"]
    x0, v0 = values["rig.angle_start"], values["rig.speed_start"]
    w = math.sqrt(k - d * d)
    x = np.exp(-d * time) * (x0 * np.cos(w * time) + (v0 + d * x0) / w * np.sin(w * time))
    return (values.get("rig.gain", 1.0) * x)[:, None]


@dataclass
class Oscillator:
    """Free decays; counts its runs and can be told to fail."""

    time: FloatArray = field(default_factory=lambda: INSTANTS)
    fails_above: float = math.inf
    runs: int = 0
    closed: bool = False

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        self.runs += 1
        if values["rig.stiffness"] <= values["rig.damping"] ** 2 or values["rig.stiffness"] > self.fails_above:
            raise FmuError("rig", f"stiffness {values['rig.stiffness']:g} is beyond what the rig takes")
        return oscillation(values, self.time)

    def close(self) -> None:
        self.closed = True


@dataclass(frozen=True)
class ServoHand:
    """A pendulum on a geared motor by Runge-Kutta: viscous friction and back-EMF brake it alike."""

    steps: int = 200
    step: float = 0.01

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, 1) angle [rad] under a sine voltage whose frequency grows with the window's number."""
        inertia, torque_gain = values["hand.inertia"], values["motor.torque_gain"]
        braking = values["hand.viscous_friction"] + torque_gain * values["motor.back_emf"]
        weight, rate = values["hand.gravity_torque"], 2.0 + window

        def derivative(t: float, x: FloatArray) -> FloatArray:
            torque = torque_gain * math.sin(rate * t) - braking * x[1] - weight * math.sin(x[0])
            return np.array([x[1], torque / inertia])

        x, h = np.array([values.get("hand.angle_start", 0.0), 0.0]), self.step
        angles = [x[0]]
        for i in range(self.steps):
            a = derivative(i * h, x)
            b = derivative((i + 0.5) * h, x + 0.5 * h * a)
            c = derivative((i + 0.5) * h, x + 0.5 * h * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + derivative((i + 1) * h, x + h * c))
            angles.append(x[0])
        return np.array(angles)[:, None]

    def close(self) -> None:
        return None


@dataclass(frozen=True)
class Moody:
    """Does what the value `mood` says: 0 answers, 1 fails, 2 dies, 3 has a bug, 4 takes a minute."""

    log: str = ""

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        mood = values.get("mood", 0.0)
        if mood == 1:
            raise FmuError(f"rig in window {window}", "does not want to")
        if mood == 2:
            os._exit(7)
        if mood == 3:
            raise ZeroDivisionError("a bug")
        if mood == 4:
            time.sleep(60)
        return np.full((3, 1), 10.0 * window + values.get("x", 0.0))

    def close(self) -> None:
        if self.log:
            Path(self.log).write_text("closed")
