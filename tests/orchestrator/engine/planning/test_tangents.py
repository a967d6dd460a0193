"""Exact derivatives of runs of native FMUs, against differences of the same systems of models in plain Python."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.errors import TangentsMissing, WiringError
from fmus.packaging import targets
from fmus.packaging.native import compiler
from orchestrator.assembly.assembly import link
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Engine, Order, Run, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part, System
from orchestrator.trace import FloatArray
from tests.support.fmus.natives import VERSIONS
from tests.support.simulation.twins import Twin, slopes, width

pytestmark = [
    pytest.mark.slow,  # compilers
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]

STEP = Fraction(1, 200)
COUNT = 20
Built = Callable[[str, int], Path]
DRIVE = ("dc_motor.torque -> pendulum.torque", "pendulum.speed -> dc_motor.speed")
GEAR = ("servo_drive.torque -> geared_pendulum.torque",)
LOOP = (
    "pendulum.angle -> energy_controller.angle",
    "pendulum.speed -> energy_controller.speed",
    "energy_controller.voltage -> dc_motor.voltage",
    *DRIVE,
)
COMMANDS: dict[tuple[str, ...], list[str]] = {DRIVE: ["dc_motor.voltage"], GEAR: ["servo_drive.voltage"], LOOP: []}
STARTS = {
    "dc_motor.inductance": 0.003,
    "dc_motor.resistance": 1.3,
    "dc_motor.torque_gain": 0.07,
    "energy_controller.sample_time": 0.01,
    "pendulum.coulomb_friction_positive": 0.004,
    "pendulum.friction_speed": 0.5,
    "pendulum.angle_start": 0.4,
    "geared_pendulum.speed_start": 0.5,
    "geared_pendulum.angle_start": 0.4,
}
MODELS = ("dc_motor", "energy_controller", "geared_pendulum", "pendulum", "servo_drive")
FIXED = ("energy_controller.sample_time", "servo_drive.gear_ratio")


@dataclass(frozen=True)
class Case:
    """A system of library models under a random command, and what it is differentiated by."""

    links: tuple[str, ...]
    values: Mapping[str, float]
    by: tuple[str, ...]
    every: Mapping[str, int]
    order: Order
    factor: float
    seed: int

    @property
    def kinds(self) -> list[str]:
        return list(dict.fromkeys(end.split(".")[0] for link in self.links for end in link.split(" -> ")))

    def system(self, shelf: Mapping[str, FmuFile]) -> System:
        parts = {name: Part(shelf[name].interface, self.every[name] * STEP) for name in self.kinds}
        wired = wire(parts, map(link, self.links), COMMANDS[self.links])
        first, *others = wired.connections
        return replace(wired, connections=(replace(first, factor=self.factor), *others))

    def run(self, system: System) -> Run:
        levels = np.random.default_rng(self.seed).normal(0, 1, COUNT // 10 + 1)
        outputs = [f"{name}.{port.name}" for name in self.kinds for port in system.parts[name].interface.of("output")]
        return Run(self.values, {name: np.repeat(levels, 10)[: COUNT + 1] for name in COMMANDS[self.links]}, outputs)

    def timing(self, engine: Engine) -> Timing:
        return Timing(COUNT * STEP, STEP, order=self.order, engine=engine)


def starts(kinds: list[str]) -> dict[str, float]:
    """Real parameters of these models, and the values around which they are drawn."""
    found = {f"{kind}.{v.name}": v for kind in kinds for v in library.find(kind).of("parameter") if v.type == "Real"}
    values = {name: STARTS.get(name, float(variable.start or 0.0)) for name, variable in found.items()}
    return {name: value for name, value in values.items() if value < 1e6}


@st.composite
def cases(draw: st.DrawFn) -> Case:
    links = draw(st.sampled_from(sorted(COMMANDS)))
    case = Case(links, {}, (), {}, Order.GAUSS_SEIDEL, 1.0, 0)
    around = starts(case.kinds)
    values = {name: start * (1 if name in FIXED else draw(st.floats(0.8, 1.25))) for name, start in around.items()}
    movable = [name for name, start in around.items() if start and name not in FIXED]
    return Case(
        links,
        values,
        tuple(draw(st.lists(st.sampled_from(movable), min_size=1, max_size=4, unique=True))),
        {kind: draw(st.integers(1, 3)) for kind in case.kinds},
        draw(st.sampled_from((Order.GAUSS_SEIDEL, Order.JACOBI))),
        draw(st.floats(0.5, 2)),
        draw(st.integers(0, 99)),
    )


@pytest.fixture(scope="module", params=VERSIONS)
def shelf(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, FmuFile]]:
    folder = tmp_path_factory.mktemp("fmus")
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(
                FmuFile(targets.build(name, folder / f"{name}.fmu", target="native", fmi=request.param))
            )
            for name in MODELS
        }


def opened(case: Case, shelf: Mapping[str, FmuFile], engine: Engine) -> Simulation:
    return Simulation(case.system(shelf), {name: Slave(shelf[name], name) for name in case.kinds}, case.timing(engine))


def require_equal(found: FloatArray, expected: FloatArray, rows: FloatArray, value: float) -> None:
    """That a derivative (K, n) by a value is that of differences, to 1e-6 and to their rounding."""
    rounding = 1e-14 * np.linalg.norm(rows) / width(value)
    assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected) + rounding


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(case=cases())
def test_one_run_gives_the_jacobian_of_a_system(shelf: Mapping[str, FmuFile], case: Case) -> None:
    system = case.system(shelf)
    run = case.run(system)
    twins = {name: Twin(name, name, shelf[name].interface) for name in case.kinds}
    with Simulation(system, twins, case.timing(Engine.PYTHON)) as twin:
        expected, alike = slopes(twin, run, case.by)
    assume(alike)
    with opened(case, shelf, Engine.COMPILED) as native, opened(case, shelf, Engine.PYTHON) as slow:
        found, again = native.sensitivities(run, case.by), slow.sensitivities(run, case.by)
        assert np.array_equal(found.rows, native.rows(run))
    assert np.array_equal(found.slopes, again.slopes)
    for place, name in enumerate(case.by):
        require_equal(found.slopes[..., place], expected[..., place], found.rows, case.values[name])


def driven(shelf: Mapping[str, FmuFile]) -> tuple[Simulation, Run]:
    """A pendulum under energy control, and a run of it."""
    values = starts(["pendulum", "energy_controller", "dc_motor"])
    case = Case(LOOP, values, (), dict.fromkeys(values_of(LOOP), 1), Order.GAUSS_SEIDEL, 1.0, 0)
    return opened(case, shelf, Engine.AUTO), case.run(case.system(shelf))


def values_of(links: tuple[str, ...]) -> list[str]:
    return Case(links, {}, (), {}, Order.GAUSS_SEIDEL, 1.0, 0).kinds


def test_a_run_that_carries_tangents_leaves_nothing_in_the_next(shelf: Mapping[str, FmuFile]) -> None:
    simulation, run = driven(shelf)
    with simulation:
        before = simulation.rows(run).copy()
        first = simulation.sensitivities(run, ["pendulum.inertia"]).slopes.copy()
        both = simulation.sensitivities(run, ["dc_motor.resistance", "pendulum.inertia"]).slopes
        assert np.array_equal(simulation.rows(run), before)
        assert np.array_equal(both[..., 1:], first)
        assert np.any(both[..., 0] != 0)


@pytest.mark.parametrize(
    ("by", "problem"),
    [
        ("energy_controller.sample_time", "it decides when samples are taken"),
        ("pendulum.mass", "mass"),
        ("pendulum.torque_", "torque_"),
    ],
)
def test_what_has_no_tangents_is_named(shelf: Mapping[str, FmuFile], by: str, problem: str) -> None:
    simulation, run = driven(shelf)
    with simulation, pytest.raises((TangentsMissing, WiringError), match=problem):
        simulation.sensitivities(run, [by])


def test_an_fmu_without_tangents_is_named_where_values_reach_it(shelf: Mapping[str, FmuFile], tmp_path: Path) -> None:
    with FmuFile(targets.build("pendulum", tmp_path / "body.fmu", target="python")) as body:
        parts = {"motor": Part(shelf["dc_motor"].interface), "body": Part(body.interface)}
        system = wire(parts, [("motor.torque", "body.torque")], ["motor.voltage"])
        components = {"motor": Slave(shelf["dc_motor"], "motor"), "body": Slave(body, "body")}
        run = Run({}, {"motor.voltage": np.ones(COUNT + 1)}, ["body.angle"])
        simulation = Simulation(system, components, Timing(COUNT * STEP, STEP))
        with simulation, pytest.raises(TangentsMissing, match="body: its FMU carries no tangents"):
            simulation.sensitivities(run, ["motor.resistance"])


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("shape", [1, 2])
def test_tangents_come_as_late_as_what_they_are_of(tmp_path: Path, fmi: int, shape: int) -> None:
    names = {"body": "pendulum", "wire": "delay"}
    with ExitStack() as stack:
        built = {name: targets.build(model, tmp_path / f"{name}.fmu", fmi=fmi) for name, model in names.items()}
        files = {name: stack.enter_context(FmuFile(file)) for name, file in built.items()}
        parts = {name: Part(file.interface) for name, file in files.items()}
        system = wire(parts, [("body.angle", "wire.signal")], ["body.torque"])
        components = {name: Slave(file, name) for name, file in files.items()}
        timing = Timing(COUNT * STEP, STEP)
        simulation = stack.enter_context(Simulation(system, components, timing))
        by = {"body.inertia": 0.004, "body.angle_start": 0.3}
        torque = {"body.torque": np.linspace(0.0, 0.02, COUNT + 1)}
        fixed = {"wire.delay": 0.0137, "wire.shape": shape}

        def rows(values: Mapping[str, float]) -> FloatArray:
            return simulation.rows(Run({**values, **fixed}, torque, ["wire.late"])).copy()

        found = simulation.sensitivities(Run({**by, **fixed}, torque, ["wire.late"]), list(by))
        assert np.array_equal(found.rows, rows(by))
        for column, (name, value) in enumerate(by.items()):
            width = 1e-5 * value
            slope = (rows(by | {name: value + width}) - rows(by | {name: value - width})) / (2 * width)
            assert found.slopes[:, 0, column] == pytest.approx(slope[:, 0], rel=1e-5, abs=1e-7)
        with pytest.raises(TangentsMissing, match="decides what of an input acts"):
            simulation.sensitivities(Run({**by, **fixed}, torque, ["wire.late"]), ["wire.delay"])
