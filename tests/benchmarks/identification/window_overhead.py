"""What a window of a calibration takes beside its stepping: values in, a free run, rows out.

The work: 501 steps of 5 ms of the Butterfly (pendulum and motor, native FMUs) as its calibration runs them, with other
parameters, start values and voltages each time. The stepping is what the loop itself took; of both the least counts.
"""

from __future__ import annotations

from fractions import Fraction
from time import perf_counter

import numpy as np

from orchestrator.assembly.assembly import ComponentSpec, open_system
from orchestrator.engine import Run, Simulation, Timing

from ..figure import Figure

COMPONENTS = {
    "motor": ComponentSpec("dc_motor", {"resistance": 1.0, "inductance": 0.0, "back_emf": 0.0}),
    "hand": ComponentSpec("pendulum", {"added_length": 0.104, "friction_speed": 0.05, "added_mass": 0.052}),
}
CONNECTIONS = ["hand.speed -> motor.speed", "motor.torque -> hand.torque"]
START = {  # of the study
    "motor.torque_gain": 2.0,
    "hand.inertia": 3e-3,
    "hand.gravity_torque": 5e-3,
    "hand.viscous_friction": 1e-3,
    "hand.coulomb_friction_positive": 2e-3,
    "hand.coulomb_friction_negative": 2e-3,
    "hand.equilibrium_angle": 0.996,
}
STEP, STEPS = Fraction(1, 200), 501  # [s]
WINDOWS, REPEATS = 20, 100
LIMIT = 1.5


def figures() -> list[Figure]:
    """Time of a window and of its stepping, and whether its rows are those of the trace."""
    with open_system(COMPONENTS, CONNECTIONS, ["motor.voltage"]) as opened:
        simulation = opened.simulation(Timing(stop=STEPS * STEP, step=STEP))
        runs = [window(seed) for seed in range(WINDOWS)]
        same = all(same_rows(simulation, run) for run in runs)
        stepping = min(simulation.execute(run).account.seconds for run in runs * REPEATS)
        whole = min(seconds(simulation, run) for run in runs * REPEATS)
    return [
        Figure("a window of the Butterfly, from its values to its rows", "-", f"{1e6 * whole:.0f} µs"),
        Figure("its stepping", "-", f"{1e6 * stepping:.0f} µs"),
        Figure(
            "a window takes x times its stepping",
            f"at most {LIMIT:g}",
            f"{whole / stepping:.2f}",
            whole <= LIMIT * stepping,
        ),
        Figure("its rows are those of the trace", "yes", "yes" if same else "no", same),
    ]


def window(seed: int) -> Run:
    """Parameters within 10 % of the study's start, a start at random, and a voltage that changes at every step."""
    rng = np.random.default_rng(seed)
    values = {
        f"{name}.{variable}": value for name, spec in COMPONENTS.items() for variable, value in spec.parameters.items()
    }
    values |= {name: value * rng.uniform(0.9, 1.1) for name, value in START.items()}
    values |= {"hand.angle_start": rng.normal(), "hand.speed_start": rng.normal()}
    return Run(values, {"motor.voltage": rng.normal(size=STEPS + 1)}, ("hand.angle",))


def same_rows(simulation: Simulation, run: Run) -> bool:
    return np.array_equal(simulation.rows(run)[:, 0], simulation.execute(run).trace["hand.angle"])


def seconds(simulation: Simulation, run: Run) -> float:
    begun = perf_counter()
    simulation.rows(run)
    return perf_counter() - begun
