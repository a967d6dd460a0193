"""Rigs of real FMUs with known truth, that recordings are drawn of again and again: how often do intervals hold it?"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from identification.estimation.parameters import InitialState, Parameter, ParameterSet
from identification.output_error.free_runs.simulator import SystemFactory, SystemSimulator
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from identification.output_error.times.delays import Estimated
from identification.output_error.times.instants import every_step
from identification.signals.resolution import resolution
from orchestrator.assembly.assembly import Assembled, ComponentSpec, SystemSpec, assemble
from orchestrator.engine import Timing
from orchestrator.trace import FloatArray
from tests.support.side_by_side import side_by_side

Stimuli = Callable[[int, FloatArray], FloatArray]
Interval = tuple[float, float]


OPTIONS = SearchOptions(
    cost_tolerance=1e-6, step_tolerance=1e-7, difference_step=1e-5, intervals=IntervalOptions("profile")
)
_LEAST = 1e-3  # of the truth: the lower bounds


@dataclass(frozen=True)
class Rig:
    """A rig, what is recorded of it, and what is estimated from that.

    Attributes:
        driven: the input that `stimulus` (window, instants (K,) [s]) drives.
        outputs: recorded ones, with the standard deviation of their white noise [unit].
        steps: output -> step in which it is recorded [unit].
        truth: what is estimated, a delay of all outputs by "latency" [s].
        wrong: constants that the estimation has wrong.
        starts: start values by window; they are estimated.
        constants: known values by window.
        off: where the search starts, times the truth.
    """

    name: str
    system: SystemSpec
    driven: str
    stimulus: Stimuli
    outputs: Mapping[str, float]
    truth: Mapping[str, float]
    windows: int = 4
    samples: int = 121
    step: Fraction = Fraction(1, 100)
    steps: Mapping[str, float] = field(default_factory=dict)
    wrong: Mapping[str, float] = field(default_factory=dict)
    starts: Mapping[str, Sequence[float]] = field(default_factory=dict)
    constants: Mapping[str, Sequence[float]] = field(default_factory=dict)
    off: float = 1.02
    options: SearchOptions = OPTIONS

    @property
    def latency(self) -> Estimated | None:
        start = self.truth.get("latency")
        return None if start is None else Estimated("latency", self.off * start, _LEAST * start, 2 * start)

    @property
    def parameters(self) -> ParameterSet:
        free = [Parameter(name, self.off * true, _LEAST * true, self._most(name)) for name, true in self.truth.items()]
        return ParameterSet((*free, *(Parameter(name, value, fixed=True) for name, value in self.wrong.items())))

    def _most(self, name: str) -> float:
        return 2 * self.truth[name] if name == "latency" else np.inf

    def window(self, window: int) -> FreeRunWindow:
        """One without what is measured."""
        time = np.arange(self.samples) * float(self.step)
        delays = (self.latency,) * len(self.outputs)
        at = every_step(delays, self.step, self.samples)
        shape = (len(at), len(self.outputs))
        return FreeRunWindow(
            name=str(window),
            trace="rig",
            start=0.0,
            step=self.step,
            count=self.samples,
            at=at,
            stimuli={self.driven: self.stimulus(window, time)},
            commands={},
            measured=np.zeros(shape),
            weight=np.ones(len(self.outputs)),
            delays=delays,
            initial={},
            readings={},
            constants={name: values[window] for name, values in self.constants.items()},
        )


@dataclass(frozen=True)
class Bench:
    """A rig's FMUs, opened once for all draws; stands as its own factory, closed by `close` of nobody."""

    rig: Rig
    simulator: SystemSimulator

    def __call__(self) -> Bench:
        return self

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        return self.simulator.simulate(window, values)

    def sensitivities(self, window: int, values: Mapping[str, float], by: Sequence[str]) -> FloatArray:
        return self.simulator.sensitivities(window, values, by)

    def close(self) -> None:
        """Nothing: the next draw uses the FMUs again."""

    @cached_property
    def clean(self) -> list[FloatArray]:
        """What would be recorded without noise."""
        starts = self.rig.starts
        return [
            self.simulate(w, {**self.rig.truth, **{name: values[w] for name, values in starts.items()}})
            for w in range(self.rig.windows)
        ]

    def drawn(self, seed: int) -> Problem:
        """The question that one draw of the noise asks."""
        rig, rng = self.rig, np.random.default_rng([7, seed])
        noise = np.array(list(rig.outputs.values()))
        counted = np.array([rig.steps.get(name, 0.0) for name in rig.outputs])
        windows = []
        for w, clean in enumerate(self.clean):
            measured = clean + noise * rng.normal(size=clean.shape)
            for column in np.flatnonzero(counted):
                measured[:, column] = counted[column] * np.round(measured[:, column] / counted[column])
            found = np.array([resolution(column) for column in measured.T])
            windows.append(Window(str(w), "rig", measured, 1 / noise, resolution=found))
        states = tuple(
            InitialState(name, tuple(rig.off * np.array(values)), estimated=True) for name, values in rig.starts.items()
        )
        return Problem(rig.parameters, tuple(windows), tuple(rig.outputs), states)


@dataclass(frozen=True)
class Draw:
    """What came of one draw: intervals by profile and local ones, and whether a misfit was told."""

    profile: Mapping[str, Interval]
    local: Mapping[str, Interval]
    told: bool
    converged: bool


def opened(rig: Rig, assembled: Assembled) -> Bench:
    """The bench of an assembled rig."""
    windows = [rig.window(w) for w in range(rig.windows)]
    timing = Timing(windows[0].stop, rig.step)
    return Bench(rig, SystemFactory(assembled, windows, tuple(rig.outputs), rig.system.values(), timing)())


def drawn(bench: Bench, seed: int) -> Draw:
    """One draw of the noise, estimated."""
    found: Estimate = estimate(bench.drawn(seed), bench, bench.rig.options)
    names = bench.rig.truth
    return Draw(
        {name: found.ci95[name] for name in names},
        {name: found.local95[name] for name in names},
        any("not how near it is to the truth" in warning for warning in found.warnings),
        found.converged,
    )


def draws(rig: Rig, count: int, processes: int) -> list[Draw]:
    """So many draws of a rig's noise."""
    with tempfile.TemporaryDirectory() as folder:
        assembled = assemble(rig.system, Path(folder), (rig.driven,))
        return side_by_side(partial(_drawing, rig, assembled), range(count), processes)


def _drawing(rig: Rig, assembled: Assembled) -> Callable[[int], Draw]:
    return partial(drawn, opened(rig, assembled))


def _sines(window: int, time: FloatArray) -> FloatArray:
    """Two sines of 2 and 1 mV that keep a pendulum moving [V]."""
    return np.asarray(2e-3 * np.sin((3.0 + window) * time) + 1e-3 * np.sin(9.0 * time + window))


MOTOR = {"torque_gain": 10.0}
BUTTERFLY = Rig(
    "Butterfly, start values estimated",
    SystemSpec(
        {
            "motor": ComponentSpec("dc_motor"),
            "hand": ComponentSpec(
                "pendulum", {"added_length": 0.1, "friction_speed": 0.1, "coulomb_friction_negative": 0.003}
            ),
        },
        (("hand.speed", "motor.speed"), ("motor.torque", "hand.torque")),
    ),
    "motor.voltage",
    _sines,
    {"hand.angle": 1e-3},
    {
        "hand.inertia": 0.00325,
        "hand.viscous_friction": 0.001,
        "hand.gravity_torque": 0.04905,
        "motor.torque_gain": 10.0,
        "hand.coulomb_friction_positive": 0.003,
    },
    starts={"hand.angle_start": (0.3, -0.2, -0.3, 0.2), "hand.speed_start": (0.0, 1.5, 0.5, -1.0)},
    constants={"hand.added_mass": (0.0, 0.0, 0.2, 0.2)},
)


def _torque(window: int, time: FloatArray) -> FloatArray:
    """A swing through the play of a gear [N.m]."""
    return np.asarray(0.02 * np.sin((4.0 + 2 * window) * time) + 0.02 * np.sin(17.0 * time + window))


TWO_MASSES = Rig(
    "two masses with play",
    SystemSpec(
        {
            "drive": ComponentSpec(
                "geared_pendulum",
                {
                    "gravity_torque": 0.0,
                    "rotor_inertia": 1e-3,
                    "stiffness": 5.0,
                    "damping": 0.01,
                    "friction_speed": 0.1,
                },
            )
        },
        (),
    ),
    "drive.torque",
    _torque,
    {"drive.angle": 5e-3, "drive.rotor_angle": 5e-3},
    {
        "drive.inertia": 0.00325,
        "drive.viscous_friction": 0.003,
        "drive.backlash": 0.02,
        "drive.rotor_inertia": 3e-4,
    },
    windows=2,
)


def _small(window: int, time: FloatArray) -> FloatArray:
    """Torques below dry friction, so that the hand creeps by as much as the noise [V]."""
    return np.asarray((7e-4 + 1e-4 * window) * np.sin(4.0 * time))


SMALL = Rig(
    "dry friction at small motion",
    SystemSpec(
        {
            "motor": ComponentSpec("dc_motor"),
            "hand": ComponentSpec("pendulum", {"friction_speed": 0.05, "coulomb_friction_negative": 0.009}),
        },
        BUTTERFLY.system.connections,
    ),
    "motor.voltage",
    _small,
    {"hand.angle": 5e-3},
    {"hand.viscous_friction": 0.004, "hand.coulomb_friction_positive": 0.009},
    windows=3,
)
LATE = Rig(
    "Butterfly, recorded late",
    BUTTERFLY.system,
    BUTTERFLY.driven,
    BUTTERFLY.stimulus,
    BUTTERFLY.outputs,
    {**BUTTERFLY.truth, "latency": 0.023},
    constants=BUTTERFLY.constants,
)
COUNTED = Rig(
    "Butterfly, in steps of a CAN signal",
    BUTTERFLY.system,
    BUTTERFLY.driven,
    BUTTERFLY.stimulus,
    BUTTERFLY.outputs,
    BUTTERFLY.truth,
    steps={"hand.angle": 3e-3},
    starts=BUTTERFLY.starts,
    constants=BUTTERFLY.constants,
)


def _bursts(window: int, time: FloatArray) -> FloatArray:
    """A command that shakes two modes of a link [1]."""
    return np.asarray(40.0 * np.sign(np.sin((5.0 + 3 * window) * time)) + 20.0 * np.sin(100.0 * time))


ARM = Rig(
    "arm",
    SystemSpec({"link": ComponentSpec("flexible_link", {"coulomb_friction": 0.002})}, ()),
    "link.command",
    _bursts,
    {"link.angle": 1e-3, "link.tip_acceleration": 0.1},
    {
        "link.inertia": 0.01,
        "link.viscous_friction": 0.1,
        "link.frequency_1": 2.5,
        "link.damping_1": 0.01,
        "link.frequency_2": 15.7,
    },
    windows=2,
    samples=201,
    step=Fraction(1, 200),
)
RIGS = (BUTTERFLY, ARM, SMALL, LATE, COUNTED)
WRONG = replace(BUTTERFLY, name="Butterfly, its added mass 5 % off its place", wrong={"hand.added_length": 0.095})
WRONG_MASSES = replace(
    TWO_MASSES, name="two masses with play, their stiffness 20 % off", wrong={"drive.stiffness": 16.0}
)
