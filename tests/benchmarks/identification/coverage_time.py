"""Do output error's 95 % intervals cover? A motor and a pendulum with dry friction, as FMUs, with a noisy angle sensor.

The known mass added in half of the windows fixes the scale. The windows run once through the FMUs; every draw adds
white noise to them and estimates parameters and start values. Draws go to one process a processor, each with one
open set of FMUs for all of its draws.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from identification.output_error.search.estimator import (
    InitialState,
    Options,
    Parameter,
    ParameterSet,
    Problem,
    Tie,
    Window,
    estimate,
)
from identification.output_error.simulator import SystemFactory, SystemSimulator
from identification.output_error.windows import FreeRunWindow
from orchestrator.assembly.assembly import Assembled, ComponentSpec, SystemSpec, assemble
from orchestrator.engine import Timing
from orchestrator.trace import FloatArray

from ..figure import Figure, Interval, coverage

NOISE = 1e-3  # rms on the angle [rad]
DRAWS, MANY = 40, 200
STEP = Fraction(1, 100)  # [s]
SAMPLES = 121  # a window
LOADS = (0.0, 0.0, 0.2, 0.2)  # added mass of each window, at 0.1 m [kg]
STARTS = ((0.3, 0.0), (-0.2, 1.5), (-0.3, 0.5), (0.2, -1.0))  # angle [rad] and speed [rad/s] of each window
OFF = 1.02  # where the search starts, times the truth
COULOMB = "hand.coulomb_friction_positive"
TRUTH = {
    "hand.inertia": 0.00325,
    "hand.viscous_friction": 0.001,
    "hand.gravity_torque": 0.04905,
    "motor.torque_gain": 10.0,
    COULOMB: 0.003,
}
SYSTEM = SystemSpec(
    {
        "motor": ComponentSpec("dc_motor"),
        "hand": ComponentSpec("pendulum", {"added_length": 0.1, "friction_speed": 0.1}),
    },
    (("hand.speed", "motor.speed"), ("motor.torque", "hand.torque")),
)


@dataclass(frozen=True)
class Bench:
    """Windows without noise, and an open system to simulate them; stands as its own factory, closed by `close`."""

    simulator: SystemSimulator
    clean: tuple[FloatArray, ...]

    def __call__(self) -> Bench:
        return self

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, 1) angle [rad]."""
        return self.simulator.simulate(window, values)

    def close(self) -> None:
        """Nothing: the next draw uses the FMUs again."""


OPTIONS = Options(cost_tolerance=1e-6, step_tolerance=1e-7, difference_step=1e-5)


def open_bench(assembled: Assembled) -> Bench:
    """FMUs opened, and the windows simulated with the true values."""
    windows = [_window(window) for window in range(len(LOADS))]
    timing = Timing(max(window.stop for window in windows), STEP)
    simulator = SystemFactory(assembled, windows, ("hand.angle",), SYSTEM.values(), timing)()
    true = TRUTH | {"hand.coulomb_friction_negative": TRUTH[COULOMB]}
    clean = tuple(simulator.simulate(w, true | _start_values(w)) for w in range(len(LOADS)))
    return Bench(simulator, clean)


def _window(window: int) -> FreeRunWindow:
    """Two sines of 2 and 1 mV that keep the pendulum moving."""
    time = np.arange(SAMPLES) * float(STEP)
    voltage = 2e-3 * np.sin((3.0 + window) * time) + 1e-3 * np.sin(9.0 * time + window)
    stimuli, constants = {"motor.voltage": voltage}, {"hand.added_mass": LOADS[window]}
    return FreeRunWindow(
        name=str(window),
        trace="bench",
        start=0.0,
        step=STEP,
        count=SAMPLES,
        rows=slice(None),
        stimuli=stimuli,
        commands={},
        measured=np.zeros((SAMPLES, 1)),
        weight=np.ones(1),
        delays=(None,),
        initial={},
        readings={},
        constants=constants,
    )


def _start_values(window: int) -> dict[str, float]:
    return dict(zip(("hand.angle_start", "hand.speed_start"), STARTS[window], strict=True))


def intervals_of_draw(bench: Bench, draw: int) -> dict[str, Interval]:
    """parameter -> 95 % interval, for one draw of the noise."""
    rng = np.random.default_rng([1, draw])
    measured = [clean + NOISE * rng.normal(size=clean.shape) for clean in bench.clean]
    windows = tuple(Window(str(w), "bench", y, np.ones(1)) for w, y in enumerate(measured))
    parameters = tuple(Parameter(name, OFF * true, 0.0) for name, true in TRUTH.items())
    states = tuple(
        InitialState(name, tuple(OFF * _start_values(w)[name] for w in range(len(LOADS))), estimated=True)
        for name in _start_values(0)
    )
    tied = ParameterSet(parameters, (Tie("hand.coulomb_friction_negative", COULOMB),))
    found = estimate(Problem(tied, windows, ("hand.angle",), states), bench, OPTIONS)
    return {name: found.ci95[name] for name in TRUTH}


_bench: list[Bench] = []  # of this worker process


def _open_in_worker(assembled: Assembled) -> None:
    _bench.append(open_bench(assembled))


def _draw_in_worker(draw: int) -> dict[str, Interval]:
    return intervals_of_draw(_bench[0], draw)


def intervals(draws: int, processes: int) -> Sequence[Mapping[str, Interval]]:
    """parameter -> 95 % interval, for each draw of the noise."""
    with tempfile.TemporaryDirectory() as folder:
        assembled = assemble(SYSTEM, Path(folder), ("motor.voltage",))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, context, _open_in_worker, (assembled,)) as pool:
            return list(pool.map(_draw_in_worker, range(draws)))


def figures(draws: int = DRAWS) -> list[Figure]:
    """Coverage of p1, p2 (viscous), p3, p4 (torque gain) and the Coulomb friction."""
    return coverage("output error", intervals(draws, os.cpu_count() or 1), TRUTH)


def endurance() -> list[Figure]:
    """The same with a narrower band."""
    return figures(MANY)
