"""The stepping loop against independent answers: exact recursions, algebraic solutions, tables worked by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.engine import Order, Simulation, Timing
from orchestrator.trace import FloatArray, Trace
from tests.support.simulation.scripted import Clock, Gain, Plant, Sampler, Scripted, interface, simulation, system

SEEDS = st.integers(0, 2**32 - 1)


@dataclass(frozen=True)
class Loop:
    """A random stable plant with a disturbance as its last input, under a random discrete controller.

    Attributes:
        every: period of the controller in steps of the plant.
        dynamic: whether the controller has states; else it is the gain D.
    """

    seed: int
    order: int
    inputs: int
    outputs: int
    dynamic: bool
    every: int
    step: Fraction
    count: int = 24

    def matrices(self) -> dict[str, FloatArray]:
        random = np.random.default_rng(self.seed)
        n, m, p, q = self.order, self.inputs, self.outputs, 2 * self.dynamic
        A = random.normal(size=(n, n))
        A -= (max(np.linalg.eigvals(A).real) + 0.2) * np.eye(n)
        F = random.normal(size=(q, q))
        return {
            "A": A,
            "B": random.normal(size=(n, m + 1)),
            "C": random.normal(size=(p, n)),
            "x0": random.normal(size=n),
            "F": F / max(1.0, 1.1 * np.linalg.norm(F, 2)) if q else F,
            "G": random.normal(size=(q, p)),
            "H": 0.3 * random.normal(size=(m, q)),
            "K": 0.3 * random.normal(size=(m, p)),
            "z0": random.normal(size=q),
            "w": random.normal(size=self.count + 1),
        }

    def components(self) -> list[Scripted]:
        v = self.matrices()
        plant = Plant("plant", v["A"], v["B"], v["C"], x0=v["x0"])
        if self.dynamic:
            return [plant, Sampler("controller", v["F"], v["G"], v["H"], v["K"], v["z0"])]
        return [plant, Gain("controller", v["K"])]

    def recursion(self) -> tuple[FloatArray, FloatArray]:
        """(count + 1, p) outputs and (count, m + 1) inputs of the plant, from x+ = Ad x + Bd u."""
        v = self.matrices()
        zero = np.zeros((self.outputs, self.inputs + 1))
        Ad, Bd, *_ = scipy.signal.cont2discrete((v["A"], v["B"], v["C"], zero), float(self.step), "zoh")
        x, z, command = v["x0"], v["z0"], np.zeros(self.inputs)
        outputs, inputs = [], []
        for k in range(self.count):
            y = v["C"] @ x
            outputs.append(y)
            if k % self.every == 0:
                command = v["H"] @ z + v["K"] @ y
                z = v["F"] @ z + v["G"] @ y
            inputs.append(np.append(command, v["w"][k]))
            x = Ad @ x + Bd @ inputs[-1]
        return np.array([*outputs, v["C"] @ x]), np.array(inputs)

    def simulate(self, reverse: bool = False, order: Order = Order.GAUSS_SEIDEL) -> Trace:
        components = self.components()
        links = [f"plant.y{i} -> controller.u{i}" for i in range(self.outputs)]
        links += [f"controller.y{i} -> plant.u{i}" for i in range(self.inputs)]
        disturbance = f"plant.u{self.inputs}"
        made = simulation(
            components[::-1] if reverse else components,
            links[::-1] if reverse else links,
            step=self.step,
            stop=self.count * self.step,
            stimulated=[disturbance],
            steps={"controller": self.every * self.step},
            order=order,
        )
        return made.run(stimuli={disturbance: self.matrices()["w"]}, record=[*self.y, *self.u]).trace

    @property
    def y(self) -> list[str]:
        return [f"plant.y{i}" for i in range(self.outputs)]

    @property
    def u(self) -> list[str]:
        return [f"plant.u{i}" for i in range(self.inputs + 1)]


def columns(trace: Trace, names: list[str]) -> FloatArray:
    return np.column_stack([trace[name] for name in names])


LOOPS = st.builds(
    Loop,
    seed=SEEDS,
    order=st.integers(1, 4),
    inputs=st.integers(1, 2),
    outputs=st.integers(1, 2),
    dynamic=st.booleans(),
    every=st.sampled_from([1, 1, 2, 3, 8]),
    step=st.sampled_from([Fraction(1, 300), Fraction(1, 50), Fraction(1, 10), Fraction(1, 3)]),
)


@pytest.mark.slow
@given(LOOPS, st.booleans())
@settings(max_examples=200)
def test_sampled_feedback_of_a_linear_plant_is_the_exact_zero_order_hold_recursion(loop: Loop, reverse: bool) -> None:
    trace = loop.simulate(reverse)
    outputs, inputs = loop.recursion()
    scale = 1.0 + np.abs(outputs).max()
    assert np.abs(columns(trace, loop.y) - outputs).max() <= 1e-9 * scale
    assert np.abs(columns(trace, loop.u)[:-1] - inputs).max() <= 1e-9 * scale


@pytest.mark.slow
@given(LOOPS)
def test_the_order_of_declaration_does_not_change_one_bit(loop: Loop) -> None:
    one, other = loop.simulate(), loop.simulate(reverse=True)
    for name in one.names:
        assert np.array_equal(one[name], other[name])


@pytest.mark.slow
@given(st.permutations(range(6)), SEEDS)
def test_no_order_of_declaration_changes_a_network_by_one_bit(order: list[int], seed: int) -> None:
    def run(arrangement: list[int]) -> Trace:
        random = np.random.default_rng(seed)
        A = -np.eye(2) + 0.3 * random.normal(size=(2, 2))
        parts: list[Scripted] = [
            Plant("p", A, np.eye(2), np.eye(2), x0=[1.0, -0.5]),
            Gain("a", 0.7),
            Gain("b", [[0.3, -0.2]]),
            Sampler("c", [[0.5]], [[1.0]], [[1.0]], [[0.1]]),
            Clock("clock"),
            Gain("d", [[1.0, 1.0]]),
        ]
        links = [
            "p.y0 -> a.u0",
            "a.y0 -> b.u0",
            "p.y1 -> b.u1",
            "b.y0 -> c.u0",
            "c.y0 -> p.u0",
            "clock.y -> d.u0",
            "c.y0 -> d.u1",
            "d.y0 -> p.u1",
        ]
        made = simulation([parts[i] for i in arrangement], links, step=Fraction(1, 20), steps={"c": Fraction(1, 10)})
        return made.run().trace

    one, other = run(list(range(6))), run(order)
    assert all(np.array_equal(one[name], other[name]) for name in one.names)


@pytest.mark.slow
@given(LOOPS.filter(lambda loop: loop.every == 1 and not loop.dynamic))
def test_jacobi_is_the_recursion_with_one_step_of_delay_in_every_component(loop: Loop) -> None:
    v = loop.matrices()
    zero = np.zeros((loop.outputs, loop.inputs + 1))
    Ad, Bd, *_ = scipy.signal.cont2discrete((v["A"], v["B"], v["C"], zero), float(loop.step), "zoh")
    x = v["x0"]
    y_before = v["C"] @ x  # outputs are passed on during initialisation
    outputs = []
    for k in range(loop.count):
        outputs.append(v["C"] @ x)
        command = v["K"] @ y_before
        y_before = outputs[-1]
        x = Ad @ x + Bd @ np.append(command, v["w"][k])
    trace = loop.simulate(order=Order.JACOBI)
    assert np.abs(columns(trace, loop.y)[:-1] - outputs).max() <= 1e-9 * (1 + np.abs(outputs).max())


def integrator(name: str = "plant", start: float = 1.0) -> Plant:
    return Plant(name, np.zeros((1, 1)), np.eye(1), np.eye(1), x0=[start])


LINKS = ["plant.y0 -> controller.u0", "controller.y0 -> plant.u0"]


def table(trace: Trace) -> dict[str, list[float]]:
    return {name: trace[name].tolist() for name in trace.names}


def test_outputs_are_recorded_as_left_limits_and_inputs_as_right_limits() -> None:
    made = simulation([integrator(), Gain("controller", -0.5)], LINKS, step=Fraction(1), stop=Fraction(3))
    trace = made.run(record=["plant.y0", "controller.u0", "controller.y0", "plant.u0"]).trace
    assert trace.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert table(trace) == {
        "plant.y0": [1.0, 0.5, 0.25, 0.125],
        "controller.u0": [1.0, 0.5, 0.25, 0.125],
        "controller.y0": [-0.5, -0.5, -0.25, -0.125],  # the value of the step that ended
        "plant.u0": [-0.5, -0.25, -0.125, -0.125],  # the value of the step that begins; none begins at the end
    }


def test_jacobi_records_one_step_of_delay() -> None:
    made = simulation(
        [integrator(), Gain("controller", -0.5)], LINKS, step=Fraction(1), stop=Fraction(3), order=Order.JACOBI
    )
    trace = made.run(record=["plant.y0", "controller.u0", "controller.y0", "plant.u0"]).trace
    assert table(trace) == {
        "plant.y0": [1.0, 0.5, 0.0, -0.25],
        "controller.u0": [1.0, 0.5, 0.0, -0.25],
        "controller.y0": [-0.5, -0.5, -0.25, 0.0],
        "plant.u0": [-0.5, -0.5, -0.25, 0.0],
    }


def test_outputs_of_a_slow_plant_change_only_at_the_end_of_its_step() -> None:
    made = simulation(
        [integrator(), Gain("controller", -0.5)],
        LINKS,
        step=Fraction(1),
        stop=Fraction(6),
        steps={"plant": Fraction(3)},
    )
    trace = made.run(record=["plant.y0", "plant.u0", "controller.y0"]).trace
    y = trace["plant.y0"]
    assert y == pytest.approx([1.0, 1.0, 1.0, -0.5, -0.5, -0.5, 0.25])
    assert np.array_equal(y, np.repeat(y[[0, 3, 6]], 3)[:7])
    assert trace["controller.y0"] == pytest.approx([-0.5, -0.5, -0.5, -0.5, 0.25, 0.25, 0.25])
    assert trace["plant.u0"] == pytest.approx([-0.5, -0.5, -0.5, 0.25, 0.25, 0.25, 0.25])


def test_a_slow_component_is_recorded_with_the_inputs_that_act_on_it() -> None:
    made = simulation(
        [Clock("clock"), integrator()],
        ["clock.y -> plant.u0"],
        step=Fraction(1),
        stop=Fraction(5),
        steps={"plant": Fraction(2)},
    )
    trace = made.run(record=["clock.y", "plant.u0", "plant.y0"]).trace
    assert table(trace) == {
        "clock.y": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
        "plant.u0": [0.0, 0.0, 2.0, 2.0, 4.0, 4.0],
        "plant.y0": [1.0, 1.0, 1.0, 1.0, 5.0, 5.0],
    }


def test_a_fast_plant_is_recorded_at_the_steps_of_the_run() -> None:
    made = simulation(
        [integrator(), Gain("controller", -1.0)],
        LINKS,
        step=Fraction(1),
        stop=Fraction(2),
        steps={"plant": Fraction(1, 4)},
    )
    result = made.run(record=["plant.y0"])
    assert result.trace["plant.y0"].tolist() == [1.0, 0.0, 0.0]
    assert result.statistics["plant"].calls == 8
    assert result.statistics["controller"].calls == 2


@pytest.mark.slow
def test_a_million_steps_end_where_they_should_and_every_time_is_correctly_rounded() -> None:
    class Witness(Scripted):
        count = wrong = 0

        def step(self, time: float, duration: float) -> None:
            self.wrong += time != self.count / 300 or duration != 1 / 300
            self.count += 1

    witness = Witness("witness", interface())
    end = simulation([witness], step=Fraction(1, 300), stop=Fraction(10**4, 3)).run().trace.time[-1]
    assert (witness.count, witness.wrong) == (10**6, 0)
    assert end == 10**4 / 3


@given(st.fractions(0, 10, max_denominator=1000), st.fractions("1/1000", 1, max_denominator=1000), st.integers(1, 3))
def test_times_handed_out_are_the_rounded_multiples_of_the_tick(start: Fraction, step: Fraction, every: int) -> None:
    slow, fast = Clock("slow"), Clock("fast")
    made = simulation([slow, fast], step=step, start=start, stop=start + 12 * step, steps={"slow": every * step})
    trace = made.run().trace
    assert [time for time, *_ in fast.steps] == [float(start + k * step) for k in range(12)]
    assert [time for time, *_ in slow.steps] == [float(start + k * every * step) for k in range(12 // every)]
    assert {duration for _, duration, _ in slow.steps} == {float(every * step)}
    assert trace.time.tolist() == [float(start + k * step) for k in range(13)]


def test_a_connection_passes_its_factor_times_the_value_and_its_offset() -> None:
    parts: list[Scripted] = [Clock("clock"), Gain("gain", 1.0)]
    wired = system(parts, ["clock.y -> gain.u0"])
    [link] = wired.connections
    wired = replace(wired, connections=(replace(link, factor=2.0, offset=273.15),))
    made = Simulation(wired, {part.name: part for part in parts}, Timing(Fraction(1), Fraction(1, 10)))
    trace = made.run().trace
    assert trace["gain.y0"][1:] == pytest.approx(2.0 * trace["clock.y"][:-1] + 273.15)


@pytest.mark.parametrize("count", [1, 2, 5, 40])
@pytest.mark.parametrize("order", list(Order))
@pytest.mark.parametrize("reverse", [False, True])
def test_initial_outputs_reach_the_end_of_a_chain_before_the_first_step(
    count: int, order: Order, reverse: bool
) -> None:
    parts = [integrator("c0", 3.0), *(Gain(f"c{i}", 1.0, 1.0) for i in range(1, count + 1))]
    links = [f"c{i}.y0 -> c{i + 1}.u0" for i in range(count)]
    made = simulation(parts[::-1] if reverse else parts, links, order=order, stop=Fraction(1, 10))
    made.run()
    assert parts[-1].steps[0][2] == (3.0 + count - 1,)
