"""How fast the flexible arm's closed loops step, and how robust its controllers are, on the nonlinear arm.

The loops are those of the scenarios at their own steps: arm, drive, sensors with noise and quantisation, controller.
Draws differ in payload (0 to 400 g), dry and viscous friction (+-50 %), torque constant (+-10 %), noise (half to
twice), in what physical.yaml's calibration leaves open of hub and beam (1 %), and half of them in one sample of delay
between controller and drive. A move has settled where the true position stays within 2 % of it, or 0.06 V, over the
last two seconds.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

import numpy as np

from fmus.models.plants.state_space import matrices, state_space
from orchestrator.assembly.assembly import Assembled, ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.engine import Run, Simulation, Timing
from orchestrator.fmi.interface import Value
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import FloatArray

from ..figure import Figure

CONTROL = Path(__file__).parents[3] / "scenarios" / "flexible_arm" / "control"
RUNS, REPEATS = 1_000, 5
STOP = Fraction(20)  # [s] of the runs that are timed
MOVE = Fraction(12)  # [s] of those that have to settle
LIMIT = 60.0  # [s]
REAL_TIME = 300.0
POTENTIOMETER = 4.911  # [V/rad]
SETTLED = 2.0  # [s] at the end in which a move has to have settled
REST = 0.005  # [rad] within which an arm at rest stays
LOOPS = {
    "PI of type II, with compensation": ("pi.yaml", {"controller.kp": 0.3998, "controller.ki": 0.0178}),
    "PDPC": ("pdpc.yaml", {}),
    "scheduled PDPC": ("schedule.yaml", {}),
    "ILQR with its friction observed": ("ilqr_friction.yaml", {}),
}
CALM: Mapping[str, Value] = {
    "arm.coulomb_friction": 0.235,
    "arm.viscous_friction": 0.03,
    "delay.C[1,1]": 0.0,
    "delay.D[1,1]": 1.0,
}
Draw = Mapping[str, Value]


def figures() -> list[Figure]:
    """Time of 1,000 closed loops, and how much faster than real time one is."""
    draws = [draw(rng) | CALM for rng in seeded(RUNS)]
    with tempfile.TemporaryDirectory() as folder:
        assembled, timing = delayed("pdpc.yaml", Path(folder), STOP)
        begun = perf_counter()
        angles = ran(assembled, timing, draws)
        spent = perf_counter() - begun
        one = alone(assembled, timing, draws[0])
    return [
        Figure(
            f"{RUNS:,} runs of 20 s of the arm under PDPC, on {os.cpu_count()} processors",
            f"at most {LIMIT:g} s",
            f"{spent:.1f} s",
            spent <= LIMIT,
        ),
        Figure(
            "one of them, in processor time",
            f"at least {REAL_TIME:g} x faster than real time",
            f"{float(STOP) / one:.0f} x",
            float(STOP) / one >= REAL_TIME,
        ),
        Figure("runs that came to their end", f"{RUNS:,}", f"{len(angles):,}", len(angles) == RUNS, certain=True),
    ]


def endurance() -> list[Figure]:
    """What settles of 1,000 draws under each controller, side by side; whether a wrong payload destabilises."""
    found = []
    draws = [draw(rng) for rng in seeded(RUNS)]
    for name, (file, values) in LOOPS.items():
        with tempfile.TemporaryDirectory() as folder:
            assembled, timing = delayed(file, Path(folder), MOVE)
            runs = [values | {k: v for k, v in one.items() if k.partition(".")[0] in assembled.files} for one in draws]
            angles = ran(assembled, timing, runs)
        share = np.mean([settled(angle, one) for angle, one in zip(angles, draws, strict=True)])
        found.append(Figure(f"{name}: draws that settle", "-", f"{100 * share:.1f} %"))
    return [*found, *wrong_payloads(draws)]


def wrong_payloads(draws: Sequence[Draw]) -> list[Figure]:
    """Whether the scheduled controller comes to rest with any payload it is told, also one that jumps.

    Friction is nominal and there is no delay: with other friction, or late, PDPC hunts whatever its gains.
    """
    with tempfile.TemporaryDirectory() as folder:
        assembled, timing = misled(Path(folder))
        calm = [one | CALM for one in draws]
        lies = [one | lie(rng) for one, rng in zip(calm, seeded(len(calm), 1), strict=True)]
        told = sum(map(quiet, ran(assembled, timing, [one | truth(one) for one in calm])))
        deceived = sum(map(quiet, ran(assembled, timing, lies)))
    name = "scheduled PDPC, told {}: draws that come to rest"
    return [
        Figure(name.format("the payload"), "-", f"{told:,} of {len(draws):,}"),
        Figure(name.format("any payload, or none"), "no fewer", f"{deceived:,} of {len(draws):,}", deceived >= told),
    ]


def seeded(count: int, stream: int = 0) -> Iterator[np.random.Generator]:
    return (np.random.default_rng([stream, number]) for number in range(count))


def draw(rng: np.random.Generator) -> dict[str, Value]:
    """Another arm, drive and noise, and a move."""
    friction, noise = rng.uniform(0.5, 1.5), rng.uniform(0.5, 2.0)
    delay = float(rng.integers(2))
    given = {
        "source.amplitude": float(rng.choice([1.0, 3.0, 5.0])),
        "arm.payload": rng.uniform(0.0, 0.4),
        "arm.coulomb_friction": 0.235 * friction,
        "arm.viscous_friction": 0.03 * rng.uniform(0.5, 1.5),
        "arm.hub_inertia": 0.003 * rng.normal(1, 0.01),
        "arm.bending_stiffness": 7.906 * rng.normal(1, 0.01),
        "drive.torque_constant": 0.5876 * rng.uniform(0.9, 1.1),
        "potentiometer.noise": 0.002 * noise,
        "tachometer.noise": 0.005 * noise,
        "middle_gauge.noise": 0.06 * noise,
        "delay.C[1,1]": delay,
        "delay.D[1,1]": 1.0 - delay,
    }
    seeds = {f"{name}.seed": int(rng.integers(2**31)) for name in ("potentiometer", "tachometer", "middle_gauge")}
    return {name: float(value) for name, value in given.items()} | seeds


def lie(rng: np.random.Generator) -> dict[str, Value]:
    """A payload that is told: a square between any two values, from below none to beyond the largest, or nothing."""
    return {
        "told.offset": float(rng.uniform(-0.2, 0.8)),
        "told.amplitude": float(rng.uniform(0, 0.5)),
        "told.frequency": float(10 ** rng.uniform(-1, 1.5)),
        "known.offset": float(rng.integers(2)),
        "controller.payload_start": float(rng.uniform(0, 0.4)),
    }


def truth(one: Draw) -> dict[str, Value]:
    """The payload is told as it is."""
    payload = one["arm.payload"]
    return {"told.offset": payload, "told.amplitude": 0.0, "known.offset": 1.0, "controller.payload_start": payload}


def delayed(file: str, folder: Path, stop: Fraction) -> tuple[Assembled, Timing]:
    """A scenario's system with room for a sample of delay before the drive: y = C u[k-1] + D u[k]."""
    scenario = load_scenario(CONTROL / file)
    return assemble(with_delay(scenario.system), folder), replace(scenario.timing, stop=stop)


def with_delay(system: SystemSpec) -> SystemSpec:
    values = matrices([[0.0]], [[1.0]], [[0.0]], [[1.0]]) | {"sample_time": 1 / 300}
    delay = ComponentSpec(state_space(1, {"u": "V"}, {"y": "V"}, direct=True), values, step=Fraction(1, 300))
    [source] = [source for source, target in system.connections if target == "drive.voltage"]
    others = tuple(link for link in system.connections if link[1] != "drive.voltage")
    links = (*others, (source, "delay.u"), ("delay.y", "drive.voltage"))
    return SystemSpec({**system.components, "delay": delay}, links)


def misled(folder: Path) -> tuple[Assembled, Timing]:
    """The scheduled loop, told a payload by sources instead of the estimator."""
    scenario = load_scenario(CONTROL / "schedule.yaml")
    system = with_delay(scenario.system)
    told = {name: ComponentSpec("excitation", {"shape": "square", "amplitude": 0.0}) for name in ("told", "known")}
    components = {name: one for name, one in system.components.items() if name != "estimator"} | told
    links = tuple(link for link in system.connections if "estimator" not in "".join(link))
    links += (("told.signal", "controller.payload"), ("known.signal", "controller.payload_known"))
    return assemble(SystemSpec(components, links), folder), replace(scenario.timing, stop=MOVE)


def ran(assembled: Assembled, timing: Timing, draws: Sequence[Draw]) -> list[FloatArray]:
    """(K,) the hub's angle [rad] at 300 Hz in each run, on all processors."""
    count = os.cpu_count() or 1
    parts = [draws[place::count] for place in range(count)]
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:
        done = list(pool.map(part, repeat(assembled), repeat(timing), parts))
    found: list[FloatArray] = [np.empty(0)] * len(draws)
    for place, angles in enumerate(done):
        found[place::count] = angles
    return found


def part(assembled: Assembled, timing: Timing, draws: Sequence[Draw]) -> list[FloatArray]:
    """The runs of one process."""
    with simulation(assembled, timing) as opened:
        return [opened.rows(run(assembled, timing, one))[:, 0] for one in draws]


def alone(assembled: Assembled, timing: Timing, one: Draw) -> float:
    """Processor time of a run [s]."""
    times = []
    with simulation(assembled, timing) as opened:
        for _ in range(REPEATS):
            begun = thread_time()
            opened.rows(run(assembled, timing, one))
            times.append(thread_time() - begun)
    return median(times)


@contextmanager
def simulation(assembled: Assembled, timing: Timing) -> Iterator[Simulation]:
    with OpenSystem(assembled) as opened, opened.simulation(timing) as running:
        yield running


def run(assembled: Assembled, timing: Timing, one: Draw) -> Run:
    own = assembled.system.values()
    # A square that does not turn round before the end: one move.
    values = own | {"source.frequency": 0.01} | dict(one)
    return Run(values, record=["arm.angle"], record_every=round(Fraction(1, 300) / timing.step))


def settled(angle: FloatArray, one: Draw) -> bool:
    wanted = float(one["source.amplitude"])
    last = angle[-round(300 * SETTLED) :]
    return bool(np.all(np.abs(POTENTIOMETER * last - wanted) <= max(0.02 * wanted, 0.06)))


def quiet(angle: FloatArray) -> bool:
    """Whether the arm has come to rest before the end."""
    return bool(np.ptp(angle[-round(300 * SETTLED) :]) <= REST)
