"""Model exchange: the exact solutions through every solver, and every wrong wish refused."""

from __future__ import annotations

import os
import pickle
import sys
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
import scipy.linalg
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fmus.errors import FmuError, FmuFileError, InputError, WiringError
from fmus.packaging import targets
from orchestrator.assembly.schema import ComponentBlock
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuFile, FmuKind
from orchestrator.fmi.slave import Slave
from orchestrator.info import about
from orchestrator.scenario.run import run_scenario
from orchestrator.solvers.base import SolverMethod, SolverSettings
from orchestrator.solvers.choice import solver_type
from orchestrator.system import Part
from tests.support.simulation.exchanging import (
    METHODS,
    TENTH,
    TIGHT,
    Shelf,
    matrices,
    simulation,
    trace,
    with_xml,
)
from tests.support.simulation.scripted import Sampler, Scripted, zero_order_hold
from tests.support.tools import third_party


@pytest.mark.parametrize("version", [2, 3])
def test_van_der_pols_equation_is_solved(version: int, shelf: Shelf) -> None:
    found = trace(shelf(f"VanDerPol{version}"), {"mu": 2.0}, stop=Fraction(10))
    exact = solve_ivp(
        lambda t, x: [x[1], 2 * (1 - x[0] ** 2) * x[1] - x[0]],
        (0, 10),
        [2.0, 0.0],
        "DOP853",
        found.time,
        rtol=1e-12,
        atol=1e-12,
    )
    assert np.abs(found["fmu.x0"] - exact.y[0]).max() < 3e-8


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("solver", METHODS, ids=lambda each: each.method)
def test_each_method_solves_dahlquists_equation(version: int, solver: SolverSettings, shelf: Shelf) -> None:
    found = trace(shelf(f"Dahlquist{version}"), {"k": 2.0}, solver=solver)
    assert np.abs(found["fmu.x"] - np.exp(-2 * found.time)).max() < 2e-8


@pytest.mark.parametrize("version", [2, 3])
def test_a_run_may_start_at_any_time(version: int, shelf: Shelf) -> None:
    fmu = shelf(f"Dahlquist{version}")
    with ExitStack() as stack:
        slave = ExchangeSlave(fmu, "fmu", TIGHT)
        stack.callback(slave.close)
        timing = Timing(Fraction(7), TENTH, start=Fraction(5))
        found = Simulation(wire({"fmu": Part(fmu.interface)}, []), {"fmu": slave}, timing).run().trace
    assert found["fmu.x"] == pytest.approx(np.exp(5 - found.time), abs=1e-8)


@pytest.mark.parametrize("method", SolverMethod)
def test_the_error_follows_the_tolerance(method: SolverMethod, shelf: Shelf) -> None:
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        found = trace(shelf("Dahlquist3"), solver=SolverSettings(method, tolerance), step=Fraction(2))
        errors.append(abs(found["fmu.x"][-1] - np.exp(-2)))
    assert all(error < 10 * tolerance for error, tolerance in zip(errors, (1e-4, 1e-6, 1e-8), strict=True))
    assert errors[0] > errors[2]


def ball(time: float, e: float = 0.7, least: float = 0.1) -> float:
    """Height of a ball dropped from 1 m that comes to rest when it leaves the floor slower than `least` [m/s]."""
    g = 9.81
    speed, landing = np.sqrt(2 * g), np.sqrt(2 / g)
    if time < landing:
        return float(1 - g * time**2 / 2)
    while (speed := e * speed) >= least:
        if time < landing + 2 * speed / g:
            return float(speed * (time - landing) - g * (time - landing) ** 2 / 2)
        landing += 2 * speed / g
    return 0.0


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("solver", METHODS, ids=lambda each: each.method)
def test_a_ball_bounces_at_its_times(version: int, solver: SolverSettings, shelf: Shelf) -> None:
    found = trace(shelf(f"BouncingBall{version}"), solver=solver, stop=Fraction(3), step=Fraction(1, 20))
    assert found["fmu.h"] == pytest.approx([ball(time) for time in found.time], abs=3e-8)


FMPY = [("VanDerPol", "x0", 1e-4), ("Dahlquist", "x", 1e-6), ("BouncingBall", "h", 1e-6), ("Stair", "counter", 0.0)]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("model", "name", "within"), FMPY)
def test_fmpys_solver_agrees(version: int, model: str, name: str, within: float, shelf: Shelf) -> None:
    judge = fmpy.simulate_fmu(
        str(third_party.reference(version, model)),
        stop_time=2.5,
        output_interval=0.2,
        relative_tolerance=1e-8,
        output=[name],
        fmi_type="ModelExchange",
        record_events=False,
        validate=False,
    )
    found = trace(shelf(f"{model}{version}"), stop=Fraction(12, 5), step=Fraction(1, 5))[f"fmu.{name}"]
    between = [k for k in range(len(found)) if k % 5]  # at whole seconds FMPy gives the stair's right limits
    assert np.abs(found - judge[name][: len(found)])[between].max() <= within


@pytest.mark.slow
@pytest.mark.parametrize("solver", METHODS, ids=lambda each: each.method)
def test_openmodelicas_mass_spring_system_moves_exactly(solver: SolverSettings) -> None:
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.array([[-2.0, 1.0], [1.0, -2.0]]), np.zeros((2, 2))]])
    with FmuFile(third_party.mass_spring("System"), FmuKind.MODEL_EXCHANGE) as fmu:
        found = trace(fmu, solver=solver)
    exact = [scipy.linalg.expm(time * A) @ [0.0, 1.0, 1.0, 0.0] for time in found.time]  # unit masses and springs
    states = np.column_stack([found[f"fmu.{name}"] for name in ("x1", "x2", "v1", "v2")])
    assert np.abs(states - exact).max() < 3e-8


@pytest.mark.parametrize("version", [2, 3])
def test_inputs_of_each_type_reach_the_fmu_within_the_step(version: int, shelf: Shelf) -> None:
    time = np.arange(21) / 10
    stimuli = {
        "fmu.Float64_continuous_input": np.sin(time),
        "fmu.Int32_input": np.floor(5 * time),
        "fmu.Boolean_input": (time > 1).astype(float),
        "fmu.Float64_discrete_input": time**2,
    }
    found = trace(shelf(f"Feedthrough{version}"), stimuli=stimuli)
    for name, samples in stimuli.items():
        assert np.array_equal(found[name.replace("input", "output")][1:], samples[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("solver", METHODS, ids=lambda each: each.method)
def test_held_inputs_give_the_matrix_exponential(version: int, solver: SolverSettings, shelf: Shelf) -> None:
    force = np.random.default_rng(1).normal(size=11)
    found = trace(shelf(f"masses{version}"), solver=solver, stop=Fraction(1), stimuli={"fmu.force": force})
    Ad, Bd = zero_order_hold(*matrices(), 0.1)
    x = np.array([1.0, 0, 0, 0])
    for k in range(10):
        x = Ad @ x + Bd[:, 0] * force[k]
        assert [found["fmu.x1"][k + 1], found["fmu.x2"][k + 1]] == pytest.approx(x[[0, 2]], abs=1e-7)


@pytest.mark.slow
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    k=st.floats(0, 20),
    d=st.floats(0, 5),
    step=st.fractions(Fraction(1, 50), Fraction(1), max_denominator=100),
    jumps=st.lists(st.sampled_from([-1.0, 0.0, 0.5, 3.0]), min_size=6, max_size=6),
)
def test_whatever_the_input_does_the_masses_move_exactly(
    shelf: Shelf, k: float, d: float, step: Fraction, jumps: list[float]
) -> None:
    found = trace(shelf("masses2"), {"k": k, "d": d}, step=step, stop=5 * step, stimuli={"fmu.force": np.array(jumps)})
    Ad, Bd = zero_order_hold(*matrices(k, d), float(step))
    x = np.array([1.0, 0, 0, 0])
    for jump in jumps[:-1]:
        x = Ad @ x + Bd[:, 0] * jump
    assert [found["fmu.x1"][-1], found["fmu.x2"][-1]] == pytest.approx(x[[0, 2]], abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method", [SolverMethod.CVODE, SolverMethod.RADAU, SolverMethod.BDF, SolverMethod.LSODA])
def test_a_stiff_system_takes_implicit_methods_few_steps(method: SolverMethod, shelf: Shelf) -> None:
    """A mode of 0.5 µs, over 10 s; fewer steps than an explicit method needs for stability alone by four decades."""
    solver = SolverSettings(method, 1e-8, most_steps=700)
    found = trace(shelf("masses2"), {"d": 1e6}, solver=solver, step=Fraction(10), stop=Fraction(10))
    exact = scipy.linalg.expm(10 * matrices(d=1e6)[0])[:, 0]
    assert [found["fmu.x1"][-1], found["fmu.x2"][-1]] == pytest.approx(exact[[0, 2]], abs=1e-6)


def test_an_explicit_method_on_a_stiff_system_is_an_error_that_names_the_way_out(shelf: Shelf) -> None:
    solver = SolverSettings(SolverMethod.DOP853, most_steps=200)
    with pytest.raises(FmuError) as failed:
        trace(shelf("masses2"), {"d": 1e6}, solver=solver, step=Fraction(10), stop=Fraction(10))
    assert str(failed.value).startswith("fmu: step from t = 0 s by 10 s: 200 internal steps reached t = 0.00")
    assert failed.value.fix == "give its `solver` more `most_steps`, or another `method`"


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("order", [["plant", "controller"], ["controller", "plant"]])
def test_a_plant_under_sampled_control_follows_the_exact_recursion(
    version: int, order: list[str], shelf: Shelf
) -> None:
    controller = Sampler("controller", [[1.0]], [[-1.0, 0.0]], [[0.2]], [[-0.5, 0.3]])
    components: dict[str, FmuFile | Scripted] = {"plant": shelf(f"masses{version}"), "controller": controller}
    links = [("plant.x1", "controller.u0"), ("plant.x2", "controller.u1"), ("controller.y0", "plant.force")]
    with simulation({name: components[name] for name in order}, links) as made:
        found = made.run().trace
    Ad, Bd = zero_order_hold(*matrices(), 0.1)
    x, z = np.array([1.0, 0, 0, 0]), 0.0
    for k in range(20):
        u = 0.2 * z - 0.5 * x[0] + 0.3 * x[2]
        x, z = Ad @ x + Bd[:, 0] * u, z - x[0]
        assert [found["plant.x1"][k + 1], found["plant.x2"][k + 1]] == pytest.approx(x[[0, 2]], abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["masses2", "masses3", "pendulum2"])
def test_the_two_interfaces_of_an_fmu_agree(name: str, shelf: Shelf) -> None:
    fmu, stimulus = shelf(name), "fmu.torque" if name == "pendulum2" else "fmu.force"
    values = {"fmu.angle_start": 1.0} if name == "pendulum2" else {"fmu.k": 1.0}
    stimuli = {stimulus: 0.02 * np.sin(np.arange(101) / 5)}
    timing = Timing(Fraction(1), Fraction(1, 100))
    with FmuFile(fmu.path) as stepping, ExitStack() as stack:
        records = []
        for slave in (Slave(stepping, "fmu"), ExchangeSlave(fmu, "fmu", TIGHT)):
            stack.callback(slave.close)
            system = wire({"fmu": Part(slave.interface)}, [], [stimulus])
            records.append(Simulation(system, {"fmu": slave}, timing).run(values, stimuli).trace)
    for each in records[0].names:
        assert np.ptp(records[0][each]) > 0
        assert np.abs(records[0][each] - records[1][each]).max() < 1e-6


def test_small_states_are_exact_where_their_nominal_value_is_small(shelf: Shelf) -> None:
    values = {"x_start": 1e-6, "rate": -1.0}
    errors = []
    for nominal in (1.0, 1e-6):
        found = trace(shelf("eventful"), {**values, "nominal": nominal}, solver=SolverSettings())
        errors.append(np.abs(found["fmu.x"] - 1e-6 * np.exp(-found.time)).max())
    assert errors[1] < 1e-11
    assert errors[0] > 1e-10


@pytest.mark.parametrize("nominal", [0.0, -2.0, float("inf")])
def test_a_nominal_value_that_is_none_does_no_harm(nominal: float, shelf: Shelf) -> None:
    fmu = shelf("eventful")
    with FmuFile(fmu.path, FmuKind.MODEL_EXCHANGE), ExitStack() as stack:
        slave = ExchangeSlave(fmu, "fmu", TIGHT)
        stack.callback(slave.close)
        slave.set({"nominal": nominal})
        slave.begin(0.0, None)
        slave.run()
        slave.step(0.0, 1.0)
        assert slave.get("x") == pytest.approx(np.exp(-1), abs=1e-7)


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("name", ["Dahlquist3", "BouncingBall2"])
def test_memory_does_not_grow_over_runs(name: str, shelf: Shelf) -> None:
    with simulation({"fmu": shelf(name)}, stop=TENTH) as made:
        for _ in range(100):
            made.run()
        before = resident()
        for _ in range(600):
            made.run()
        assert resident() - before < 512 * 1024


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_what_cvode_allocates_is_freed() -> None:
    def cycles(count: int) -> None:
        for _ in range(count):
            solver = solver_type(SolverMethod.CVODE, "test")(lambda t, x: -x, 100, TIGHT)  # a Jacobian of 80 kB
            solver.restart(0.0, np.ones(100), np.ones(100))
            solver.step(1.0)
            solver.close()
            solver.close()

    cycles(20)
    before = resident()
    cycles(100)
    assert resident() - before < 2 << 20


@pytest.mark.parametrize("solver", [None, {"method": "Radau", "relative_tolerance": 1e-9}, {}])
def test_an_fmu_without_co_simulation_is_exchanged_and_one_with_both_only_where_asked(
    solver: dict[str, Any] | None, shelf: Shelf
) -> None:
    for name, kind in (
        ("Dahlquist3", FmuKind.CO_SIMULATION if solver is None else FmuKind.MODEL_EXCHANGE),
        ("eventful", FmuKind.MODEL_EXCHANGE),
    ):
        block = ComponentBlock.model_validate({"fmu": shelf(name).path, "solver": solver})
        spec = pickle.loads(pickle.dumps(block.spec(Path())))
        with spec.open(shelf(name).path) as file, ExitStack() as stack:
            component = spec.maker(file)(file, "fmu")
            stack.callback(component.close)
            assert file.kind is kind
            assert isinstance(component, ExchangeSlave if kind is FmuKind.MODEL_EXCHANGE else Slave)
            if solver and kind is FmuKind.MODEL_EXCHANGE:
                assert component._settings == SolverSettings(SolverMethod.RADAU, 1e-9)


SCENARIO = """
title: A ball
components:
  ball: {{fmu: "{path}", solver: {solver}}}
run: {{stop: 1, step: 0.1}}
expect:
  - {{signal: ball.h, after: 1, near: {height}, within: 1.0e-6}}
"""


def scenario(folder: Path, path: Path, solver: str) -> Path:
    (folder / "ball.yaml").write_text(SCENARIO.format(path=path, solver=solver, height=ball(1.0)))
    return folder / "ball.yaml"


def test_a_scenario_chooses_the_solver(tmp_path: Path) -> None:
    for solver in ("{}", "{method: DOP853, relative_tolerance: 1.0e-8, most_steps: 100}"):
        assert run_scenario(scenario(tmp_path, third_party.reference(3, "BouncingBall"), solver)).passed


BAD = [
    ("{method: euler}", "input should be 'cvode', 'RK45', 'DOP853', 'Radau', 'BDF' or 'LSODA'"),
    ("{relative_tolerance: 0}", "components.ball.solver.relative_tolerance: "),
    ("{relative_tolerance: 1.0e-15}", "components.ball.solver.relative_tolerance: "),
    ("{most_steps: 0}", "components.ball.solver.most_steps: "),
    ("{step: 0.1}", "components.ball.solver"),
]


@pytest.mark.parametrize(("solver", "problem"), BAD)
def test_solver_settings_that_make_no_sense_are_refused(solver: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        run_scenario(scenario(tmp_path, third_party.reference(3, "BouncingBall"), solver))
    assert problem in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_solver_for_an_fmu_with_co_simulation_only_is_refused(tmp_path: Path) -> None:
    path = targets.build("pendulum", tmp_path / "pendulum.fmu", target="python")
    with pytest.raises(FmuFileError) as refused:
        run_scenario(scenario(tmp_path, path, "{}"))
    assert str(refused.value).endswith(
        "pendulum.fmu: offers no model exchange, only co-simulation; remove its `solver`"
    )


def test_a_clock_that_does_not_say_when_it_ticks_is_refused(tmp_path: Path) -> None:
    clock = '<Clock name="tick" valueReference="99" causality="input" intervalVariability="constant"/>'
    path = with_xml(third_party.reference(3, "Dahlquist"), tmp_path, ("</ModelVariables>", f"{clock}</ModelVariables>"))
    with pytest.raises(FmuFileError, match="tick: is constant and has no interval; give intervalDecimal"):
        FmuFile(path, FmuKind.MODEL_EXCHANGE)


@pytest.mark.parametrize("count", ["-1", "99999999999"])
def test_a_number_of_indicators_that_cannot_be_is_refused(count: str, shelf: Shelf, tmp_path: Path) -> None:
    path = with_xml(
        shelf("eventful").path, tmp_path, ('numberOfEventIndicators="1"', f'numberOfEventIndicators="{count}"')
    )
    with FmuFile(path) as fmu, pytest.raises(FmuFileError, match=f"fmu: has 1 states and {count} event indicators"):
        trace(fmu)


def test_too_many_states_for_cvode_are_an_error_that_names_the_way_out(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.solvers.cvode._LARGEST", 3)
    with pytest.raises(FmuError) as failed:
        trace(shelf("masses2"))
    assert str(failed.value) == (
        "fmu: initialise: there is no memory for a Jacobian of 4 by 4 numbers; give its `solver` an explicit `method`"
    )


def test_where_cvode_cannot_be_loaded_the_way_out_is_named(shelf: Shelf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "orchestrator.solvers.cvode", None)
    with pytest.raises(WiringError) as refused:
        ExchangeSlave(shelf("eventful"), "plant")
    assert str(refused.value).startswith("plant.solver: CVODE cannot be loaded (")
    assert refused.value.fix == "use `method: BDF` or `Radau`"


def test_info_says_which_interfaces_there_are(shelf: Shelf) -> None:
    assert about(third_party.reference(3, "Dahlquist"))["interfaces"] == "co-simulation, model exchange"
    assert about(shelf("eventful").path)["interfaces"] == "model exchange"
    assert about(third_party.coupled_clutches())["interfaces"] == "co-simulation"
