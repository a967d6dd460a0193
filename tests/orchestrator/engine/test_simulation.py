"""Simulations are run again and again: fresh each time, checked before, accounted for after; with real FMUs, too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, InputError, WiringError
from fmus.packaging import targets
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Order, Simulation, Timing
from orchestrator.engine.recording import require_room
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.simulation.scripted import Clock, Gain, Plant, Scripted, simulation

LINKS = ["plant.y0 -> gain.u0", "gain.y0 -> plant.u0"]


def loop(**more: Any) -> Simulation:
    plant = Plant("plant", [[0.0, 1.0], [-4.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]], x0=[1.0, 0.0])  # type: ignore[arg-type]
    return simulation([plant, Gain("gain", -0.5), Clock("clock", 2.0)], LINKS, **more)


def scripted(made: Simulation, name: str) -> Scripted:
    component = made.components[name]
    assert isinstance(component, Scripted)
    return component


def same(one: Trace, other: Trace) -> bool:
    return one.names == other.names and all(np.array_equal(one[name], other[name]) for name in one.names)


def test_life_cycle_is_begin_run_step_and_reset_before_the_next_run() -> None:
    made = loop(stop=Fraction(2, 10))
    made.run()
    made.run()
    once = ["begin", "run", "step", "step", "terminate"]
    assert scripted(made, "gain").log == [*once, "reset", *once]


def test_a_record_takes_memory_by_its_rows_and_its_columns() -> None:
    require_room(10_000, 10)
    with pytest.raises(InputError, match="values to keep would take 8,000,000 GB"):
        require_room(10_000_000, 100_000_000)


def test_a_run_repeats_bitwise_after_a_run_with_other_values() -> None:
    made = loop()
    first = made.run().trace
    other = made.run({"clock.factor": 3.0}).trace
    assert same(made.run().trace, first)
    assert not same(other, first)
    assert other["clock.y"] == pytest.approx(1.5 * first["clock.y"])


@pytest.mark.parametrize("fail_at", [0, 1, 9])
def test_a_failed_run_leaves_nothing_behind(fail_at: int) -> None:
    made = loop()
    first = made.run().trace
    scripted(made, "plant").fail_at = fail_at
    with pytest.raises(FmuError, match=f"plant: step from t = {fail_at / 10:g} s by 0.1 s: returned error"):
        made.run({"clock.factor": 7.0})
    scripted(made, "plant").fail_at = None
    assert same(made.run().trace, first)


def test_values_of_a_run_that_was_refused_do_not_reach_the_next() -> None:
    made = loop()

    def refuse(values: object) -> None:
        raise FmuError("gain", "refuses")

    gain = scripted(made, "gain")
    gain.set, kept = refuse, gain.set  # type: ignore[method-assign]
    with pytest.raises(FmuError, match="refuses"):
        made.run({"clock.factor": 7.0})
    gain.set = kept  # type: ignore[method-assign]
    assert same(made.run().trace, loop().run().trace)


def test_warnings_are_counted_for_each_run_alone() -> None:
    made = loop()
    scripted(made, "plant").warn_at = frozenset({0, 3})
    assert made.run().warnings == {"plant": 2, "gain": 0, "clock": 0}
    assert made.run().warnings == {"plant": 2, "gain": 0, "clock": 0}


def test_statistics_count_every_call_and_its_time() -> None:
    made = loop(steps={"plant": Fraction(1, 20)})
    statistics = made.run().statistics
    assert {name: each.calls for name, each in statistics.items()} == {"plant": 20, "gain": 10, "clock": 10}
    assert all(each.seconds > 0 for each in statistics.values())
    assert {name: each.calls for name, each in made.run().statistics.items()}["plant"] == 20


def test_the_default_record_is_all_outputs_in_order_of_declaration() -> None:
    assert loop().run().trace.names == ("plant.y0", "gain.y0", "clock.y")


def test_the_record_is_what_was_asked_for_in_that_order_once() -> None:
    trace = loop().run(record=["plant.u0", "clock.y", "plant.u0", "gain.u0", "plant.y0"]).trace
    assert trace.names == ("plant.u0", "clock.y", "gain.u0", "plant.y0")
    assert trace["clock.y"][-1] == pytest.approx(2.0)
    assert np.array_equal(trace["gain.u0"], trace["plant.y0"])


def test_nothing_may_be_recorded() -> None:
    assert loop().run(record=[]).trace.names == ()


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("clock.z", "no variable 'z' in 'clock'"),
        ("clok.y", "did you mean 'clock'"),
        ("clock", "does not name a variable"),
    ],
)
def test_a_record_that_does_not_exist_is_refused_before_anything_runs(name: str, problem: str) -> None:
    made = loop()
    with pytest.raises(WiringError, match=problem):
        made.run(record=["clock.y", name])
    assert scripted(made, "clock").log == []


def test_a_value_that_does_not_exist_is_refused_before_anything_runs() -> None:
    made = loop()
    with pytest.raises(WiringError, match=r"clock\.factr: no variable"):
        made.run({"clock.factr": 1.0})
    assert scripted(made, "clock").log == []


@pytest.mark.parametrize(("value", "problem"), [(0.5, "is 0.5, outside"), (4.5, "is 4.5, outside"), (np.nan, "is nan")])
def test_a_value_outside_its_bounds_is_refused_before_anything_runs(value: float, problem: str) -> None:
    clock = Clock("clock")
    bounded = replace(clock.interface.ports["factor"], minimum=1.0, maximum=4.0)
    clock.interface = replace(clock.interface, ports={**clock.interface.ports, "factor": bounded})
    made = simulation([clock])
    with pytest.raises(WiringError, match=rf"clock\.factor: {problem}"):
        made.run({"clock.factor": value})
    assert clock.log == []
    for allowed in (1.0, 4.0):
        assert made.run({"clock.factor": allowed}).trace["clock.y"][-1] == pytest.approx(allowed)


def test_a_run_may_stop_early_and_begins_like_the_whole() -> None:
    made = loop()
    whole, part = made.run().trace, made.run(stop=Fraction(4, 10)).trace
    assert part.time.tolist() == whole.time[:5].tolist()
    assert np.array_equal(part["plant.y0"], whole["plant.y0"][:5])


@pytest.mark.parametrize(
    ("stop", "line"),
    [
        ("0", "stop: 0 s is not after 0 s and up to 1 s; choose a time between"),
        ("-1", "stop: -1 s is not after 0 s and up to 1 s; choose a time between"),
        ("1.1", "stop: 1.1 s is not after 0 s and up to 1 s; choose a time between"),
        ("0.25", "stop: 0.25 s is not a multiple of 0.1 s; use 0.2 s"),
    ],
)
def test_a_stop_that_does_not_fit_is_refused(stop: str, line: str) -> None:
    with pytest.raises(WiringError) as refused:
        loop(steps={"plant": Fraction(1, 20)}).run(stop=Fraction(stop))
    assert str(refused.value) == line


def test_a_stop_that_is_no_multiple_of_the_step_is_refused_counted_from_the_start() -> None:
    with pytest.raises(WiringError) as refused:
        loop(start=Fraction(1, 3), stop=Fraction(3, 2)).run()
    assert str(refused.value) == "stop - start: 7/6 s is not a multiple of 0.1 s; use 1.2 s"


def driven() -> Simulation:
    plant = Plant("plant", [[0.0]], [[1.0, 1.0]], [[1.0]])  # type: ignore[arg-type]
    return simulation([plant], stimulated=["plant.u1", "plant.u0"], steps={"plant": Fraction(1, 20)})


@given(st.lists(st.floats(-1e3, 1e3), min_size=10, max_size=10))
@settings(max_examples=30)
def test_a_stimulus_acts_from_its_instant_until_the_next(samples: list[float]) -> None:
    values = np.array([*samples, 0.0])
    trace = driven().run(stimuli={"plant.u0": values, "plant.u1": -2 * values}, record=["plant.y0", "plant.u0"]).trace
    assert trace["plant.u0"].tolist() == values.tolist()
    assert trace["plant.y0"] == pytest.approx(np.append(0.0, np.cumsum(-0.1 * values[:-1])), rel=1e-9, abs=1e-9)


def test_a_tunable_parameter_acts_from_the_step_on_that_begins_at_its_instant() -> None:
    clock = Clock("clock")
    clock.interface = replace(
        clock.interface, ports={n: replace(port, variability="tunable") for n, port in clock.interface.ports.items()}
    )
    factor = np.array([1.0] * 4 + [3.0] * 7)
    made = simulation([clock], stimulated=["clock.factor"])
    trace = made.run(stimuli={"clock.factor": factor}, record=["clock.y"]).trace
    np.testing.assert_allclose(trace["clock.y"][1:], trace.time[1:] * factor[:-1], atol=1e-12)


def test_stimuli_are_sampled_at_the_communication_instants() -> None:
    assert driven().instants().tolist() == [k / 10 for k in range(11)]


@pytest.mark.parametrize(
    ("second", "problem"),
    [
        (None, r"stimuli: \['plant.u0'\] given; give \['plant.u0', 'plant.u1'\]"),
        (np.zeros(10), r"plant.u1: has samples of shape \(10,\); give 11, one an instant"),
        (np.zeros((11, 1)), r"plant.u1: has samples of shape \(11, 1\)"),
        (np.full(11, np.nan), r"plant.u1: is driven by a sample that is not finite"),
    ],
)
def test_stimuli_that_do_not_fit_are_refused_before_anything_runs(second: Any, problem: str) -> None:
    made = driven()
    stimuli = {"plant.u0": np.zeros(11)} | ({} if second is None else {"plant.u1": second})
    with pytest.raises(WiringError, match=problem):
        made.run(stimuli=stimuli)
    assert scripted(made, "plant").log == []


def test_progress_rises_to_one() -> None:
    seen: list[float] = []
    simulation([Clock("clock")], step=Fraction(1, 1000), stop=Fraction(9)).run(progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 3
    assert seen[-1] == 1.0


def test_the_trace_carries_exact_times_and_no_unit_where_the_fmu_has_none() -> None:
    trace = loop(step=Fraction(1, 300), stop=Fraction(1, 3)).run().trace
    assert not trace.units
    assert trace.time.tolist() == [k / 300 for k in range(101)]


def test_leaving_the_simulation_closes_every_component() -> None:
    with pytest.raises(ZeroDivisionError), loop() as made:
        raise ZeroDivisionError
    assert [scripted(made, name).closed for name in made.components] == [1, 1, 1]


PLANT = '''"""A linear plant of second order."""

from .model import Model, State, input_, output, parameter


def derivatives(t, x, u, p):
    return {"position": x.speed, "speed": p.a21 * x.position + p.a22 * x.speed + p.b * u.force}


def solver_step(p):
    return 0.001


MODEL = Model(
    name="linear_plant",
    description="x'' = a21 x + a22 x' + b force",
    variables=(
        input_("force", "N", "Force"),
        output("position", "m", "Position"),
        output("speed", "m/s", "Speed"),
        parameter("a21", "1/s2", -4.0, "Stiffness over mass, negative"),
        parameter("a22", "1/s", -0.4, "Damping over mass, negative"),
        parameter("b", "1/kg", 1.0, "One over the mass"),
        parameter("position_start", "m", 1.0, "Position at the start"),
    ),
    states=(State("position", "position_start", "m"), State("speed", 0.0, "m/s")),
    derivatives=derivatives,
    solver_step=solver_step,
)
'''

CONTROLLER = '''"""A sampled controller with integral action."""

from .model import Model, State, input_, output, parameter


def update(t, x, u, p):
    integral = x.integral - u.position
    return {"integral": integral, "force": p.ki * integral - p.kp * u.position - p.kd * u.speed}


MODEL = Model(
    name="sampled_controller",
    description="PID on position and speed",
    variables=(
        input_("position", "m", "Position"),
        input_("speed", "m/s", "Speed"),
        output("force", "N", "Force"),
        parameter("kp", "N/m", 0.5, "Proportional gain"),
        parameter("ki", "N/m", 0.05, "Integral gain"),
        parameter("kd", "N.s/m", 0.2, "Derivative gain"),
        parameter("sample_time", "s", 0.05, "Sample period"),
    ),
    states=(State("integral", 0.0, sampled=True), State("force", 0.0, "N", sampled=True)),
    update=update,
    sample_time="sample_time",
)
'''


@pytest.fixture(scope="module")
def linear_fmus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, FmuFile]]:
    """FMUs of the two models above, by component."""
    folder = tmp_path_factory.mktemp("linear")
    opened = {}
    for name, text in {"plant": PLANT, "controller": CONTROLLER}.items():
        source = folder / f"{name}.py"
        source.write_text(text)
        opened[name] = FmuFile(targets.build(source, folder / f"{name}.fmu", target="python"))
    yield opened
    for fmu in opened.values():
        fmu.close()


def linear_loop(
    fmus: dict[str, FmuFile],
    names: list[str],
    step: Fraction,
    controller_step: Fraction,
    order: Order = Order.GAUSS_SEIDEL,
) -> Simulation:
    parts = {name: Part(fmus[name].interface, controller_step if name == "controller" else None) for name in names}
    links = [
        ("plant.position", "controller.position"),
        ("plant.speed", "controller.speed"),
        ("controller.force", "plant.force"),
    ]
    slaves = {name: Slave(fmus[name], name) for name in names}
    return Simulation(wire(parts, links), slaves, Timing(Fraction(2), step, order=order))


def exact(values: dict[str, float], step: float, every: int, count: int) -> tuple[list[float], list[float]]:
    """Positions and forces of the sampled loop, from the exact discretisation."""
    A = np.array([[0.0, 1.0], [values["plant.a21"], values["plant.a22"]]])
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), step, "zoh")
    x, integral, force = np.array([1.0, 0.0]), 0.0, 0.0
    positions, forces = [1.0], []
    for k in range(count):
        if k % every == 0:
            integral -= x[0]
            force = values["controller.ki"] * integral - values["controller.kp"] * x[0] - values["controller.kd"] * x[1]
        forces.append(force)
        x = Ad @ x + Bd[:, 0] * force
        positions.append(float(x[0]))
    return positions, forces


@pytest.mark.parametrize(("step", "every"), [(Fraction(1, 20), 1), (Fraction(1, 100), 5)])
@pytest.mark.parametrize("names", [["plant", "controller"], ["controller", "plant"]])
def test_fmus_in_a_sampled_loop_follow_the_exact_recursion(
    linear_fmus: dict[str, FmuFile], names: list[str], step: Fraction, every: int
) -> None:
    random = np.random.default_rng(7)
    with linear_loop(linear_fmus, names, step, Fraction(1, 20)) as made:
        for _ in range(4):
            values = {
                "plant.a21": -random.uniform(1, 9),
                "plant.a22": -random.uniform(0.1, 2),
                "controller.kp": random.uniform(-0.5, 1),
                "controller.ki": random.uniform(0, 0.05),
                "controller.kd": random.uniform(0, 0.5),
            }
            trace = made.run(values, record=["plant.position", "plant.force"]).trace
            positions, forces = exact(values, float(step), every, len(trace) - 1)
            assert np.abs(trace["plant.position"] - positions).max() < 1e-9
            assert np.abs(trace["plant.force"][:-1] - forces).max() < 1e-9


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.floats(-9, -0.5), st.floats(-2, 0))
def test_an_fmu_alone_is_the_matrix_exponential(linear_fmus: dict[str, FmuFile], a21: float, a22: float) -> None:
    system = wire({"plant": Part(linear_fmus["plant"].interface)}, [])
    with Simulation(
        system, {"plant": Slave(linear_fmus["plant"], "plant")}, Timing(Fraction(1), Fraction(1, 10))
    ) as made:
        trace = made.run({"plant.a21": a21, "plant.a22": a22}).trace
    Ad = scipy.linalg.expm(np.array([[0.0, 1.0], [a21, a22]]))
    assert [trace["plant.position"][-1], trace["plant.speed"][-1]] == pytest.approx(Ad[:, 0], abs=1e-9)


def test_fmus_run_a_again_after_b_bitwise(linear_fmus: dict[str, FmuFile]) -> None:
    with linear_loop(linear_fmus, ["plant", "controller"], Fraction(1, 20), Fraction(1, 20)) as made:
        a, b = {"plant.a21": -3.0, "controller.ki": 0.1}, {"plant.position_start": -0.3, "controller.kp": 0.9}
        first, other = made.run(a).trace, made.run(b).trace
        assert same(made.run(a).trace, first)
        assert same(made.run(b).trace, other)
        assert not same(first, other)
