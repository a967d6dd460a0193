"""What the tests of built FMUs share: values that use every part of a model, inputs, and instances kept open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from fmus import library
from fmus.modelling import ops
from fmus.modelling.model import Model, State, Variable, element, element_names, input_, output, parameter, start_values
from fmus.packaging.description import interface
from tests.support.fmus.either import opened

NAMES = library.names()
CONTINUOUS = [name for name in NAMES if interface.exchangeable(library.find(name))]
VERSIONS = (2, 3)
PENDULUM = library.find("pendulum")
FEEDBACK = {
    "A[1,1]": 0.8,
    "A[1,2]": 0.2,
    "A[2,2]": 0.7,
    "B[1,1]": 0.4,
    "B[2,1]": -0.3,
    "K[1,1]": 0.5,
    "K[1,2]": -0.2,
    "x_start[2]": 0.6,
    "sample_time": 0.02,
}
RICH: dict[str, dict[str, float]] = {
    "pendulum": {"angle_start": 1.0, "coulomb_friction_positive": 0.004, "stribeck_friction": 0.002},
    "geared_pendulum": {"angle_start": 1.0, "coulomb_friction_negative": 0.004, "backlash": 0.05, "stiffness": 2.0},
    "linear_axis": {
        "speed_start": 0.5,
        "viscous_friction_negative": 0.4,
        "coulomb_friction_positive": 0.3,
        "coulomb_friction_negative": 0.4,
        "stribeck_friction": 0.1,
        "friction_speed": 0.05,
        "bristle_stiffness": 20.0,
        "bristle_damping": 0.5,
    },
    "dc_motor": {"inductance": 0.01, "current_limit": 0.8, "back_emf": 0.2},
    "energy_controller": {"amplitude": 1.2, "sample_time": 0.03},
    "excitation": {"shape": 2, "amplitude": 2.0, "begin": 0.1},
    "delay": {"delay": 0.07, "before": 0.5},
    "daq": {"noise": 0.1, "bits": 8, "range": 2.0, "filter_order": 2, "cutoff": 5.0, "sample_time": 0.02},
    "flexible_arm": {
        "bending_stiffness": 0.05,
        "hub_inertia": 0.05,
        "bristle_stiffness": 20.0,
        "bristle_damping": 0.5,
        "stribeck_friction": 0.05,
        "stribeck_speed": 0.3,
        "gear_stiffness": 15.0,
        "backlash": 0.02,
        "payload": 0.1,
        "stop_stiffness": 25.0,
        "stop_angle": 0.3,
        "angle_start": 0.25,
        "speed_start": 1.0,
    },
    "flexible_link": {
        "torque_gain": 0.2,
        "command_limit": 0.6,
        "drive_time": 0.02,
        "bristle_stiffness": 0.5,
        "bristle_damping": 0.01,
        "cogging_torque": 0.004,
        "softening": 0.3,
        "drag": 1.0,
        "speed_start": 1.0,
    },
    "servo_drive": {"direction": 2, "voltage_limit": 0.6, "gear_ratio": 3.0},
    "pd": {"compensated_by": 2, "sample_time": 0.02, "error_band": 0.05, "gains": 2},
    "pi": {"ki": 3.0, "voltage_limit": 0.8, "anti_windup": 2, "sample_time": 0.02},
    "pdp": {"gains": 2, "transfer_time": 0.05, "sample_time": 0.02},
    "pdpc": {
        "speed_band": 0.3,
        "error_band": 0.5,
        "waking_band": 0.6,
        "speed_cutoff": 4.0,
        "voltage_limit": 1.5,
        "sample_time": 0.02,
    },
    "notch": {"frequency": 2.0, "voltage_limit": 0.6, "sample_time": 0.02},
    "ilqr": {**FEEDBACK, "C[1,1]": 1.0, "L[1,1]": 0.3, "L[2,1]": -0.1, "anti_windup": 2},
    "lqg": {**FEEDBACK, "C[1,1]": 1.0, "C[4,2]": 0.7, "L[1,2]": 0.3, "L[2,4]": -0.1, "ki": 2.0},
    "gain_schedule": {"kp[1]": 0.3, "kd[3]": 2.0, "payload_start": 0.1, "sample_time": 0.02},
    "disturbance_observer": {"bandwidth": 2.0, "compensation_limit": 0.3, "sample_time": 0.02},
    "payload_estimator": {"force_error": 1e-4, "memory": 0.5, "sample_time": 0.02},
    "relay_bound": {"bound": 0.6, "sample_time": 0.02},
    "state_space": {
        "A[1,1]": 0.9,
        "A[1,2]": 0.2,
        "A[2,1]": -0.3,
        "A[2,2]": 0.8,
        "B[2,1]": 0.5,
        "C[1,1]": 1.5,
        "C[1,2]": -0.4,
        "x_start[1]": 1.0,
        "x_start[2]": -0.7,
        "sample_time": 0.02,
    },
}
KEPT: dict[Path, Any] = {}


def drive(t: float) -> float:
    return 0.5 + 0.3 * math.sin(5 * t)


def advance(fmu: Any, first: int, last: int) -> list[float]:
    """Steps first to last of a data acquisition, and what it shows then."""
    for k in range(first, last):
        fmu.set("signal", drive(k * 0.01))
        fmu.step(k * 0.01, 0.01)
    values: list[float] = fmu.get("measured", "signal")
    return values


def value_of(name: str, variable: Variable) -> st.SearchStrategy[Any]:
    """Values within the bounds, near that of the rich example; nearer for a beam: its solver steps must not be tiny."""
    start = float(RICH[name].get(variable.name, variable.start or 0))
    span = 0.15 * abs(start) if name.startswith("flexible") else 5
    low = max(start - span, -math.inf if variable.minimum is None else max(variable.minimum, 0.02))
    high = max(low, min(start + span, math.inf if variable.maximum is None else variable.maximum))
    return st.integers(math.ceil(low), math.floor(high)) if variable.type == "Integer" else st.floats(low, high)


def in_arrays(model: Model, values: Mapping[str, float]) -> dict[str, Any]:
    """Start values as FMI 3.0 has them: arrays whole, their elements row by row."""
    starts = start_values(model) | values
    arrays = {name: [starts[part] for part in element_names(name, shape)] for name, shape in model.arrays.items()}
    return {name: value for name, value in values.items() if element(name) is None} | arrays


class cached:  # noqa: N801 - reads as the function `opened` does
    """One instance an FMU for all examples, reset before each."""

    def __init__(self, path: Path) -> None:
        if path not in KEPT:
            KEPT[path] = opened(path).__enter__()
        self.fmu = KEPT[path]

    def __enter__(self) -> Any:
        self.fmu.fmu.reset()
        return self.fmu

    def __exit__(self, *_: object) -> None:
        pass


def everything() -> Model:
    """A model that calls each function of ops, nested choices in conditions too."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        side = ops.where(ops.where(u.a > 0, p.k, u.b) > ops.minimum(p.k, 2.0), u.a * x.x, ops.absolute(u.b - x.x))
        return {"x": side - x.x**3 + ops.playback(p.played, t + p.k) + ops.tan(0.3 * u.a) / (1 + p.k**-2)}

    def outputs(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        first = ops.exp(-(x.x**2)) * ops.sin(u.a) + ops.log(2 + p.k) ** 2 - ops.sqrt(1 + x.x**2) / (3 - ops.cos(u.b))
        second = ops.clip(x.x * u.a, -0.2, 5.0) + ops.sign(u.b) * ops.tanh(p.k) + ops.floor(u.a * 10) * u.b
        noise = ops.uniform(p.seed, ops.floor(t)) * u.a + ops.maximum(u.a, ops.maximum(u.b, x.x)) ** p.k
        second += ops.dot([u.a, x.x, 2.0], [p.k, u.b, ops.sin(x.x)])
        return {"y": first - second * 2.0**p.k / (1 / x.x), "z": noise - (first - (second - 1.5)) - -u.b}

    return Model(
        name="everything",
        description="Every function",
        derivatives=derivatives,
        outputs=outputs,
        variables=(
            input_("a", "1", "Input", 0.5),
            input_("b", "1", "Input", -0.3),
            output("y", "1", "Output"),
            output("z", "1", "Output"),
            parameter("k", "1", 1.1, "Parameter"),
            parameter("seed", "1", 3, "Seed"),
            parameter("x_start", "1", 0.4, "Start"),
        ),
        states=(State("x", "x_start"),),
        solver_step=lambda p: 0.05 / ops.maximum(p.k, 0.1),
        tables=("played",),
    )
