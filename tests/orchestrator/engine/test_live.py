"""A run that is stepped from outside takes the very steps of a run whose stimuli are the same inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuError, InputError, WiringError
from fmus.packaging import targets
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Engine, LiveRun, Result, Run, Simulation, Timing, compiled
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import FloatArray, Trace, joined
from tests.support.simulation.scripted import Gain, Plant, Sampler, simulation, zero_order_hold

STEP, COUNT = Fraction(1, 200), 5000  # rows in more than one block
PARAMETERS = {"encoder.sample_time": 0.02, "encoder.noise": 1e-3, "hand.added_mass": 0.1}
RECORD = ["hand.angle", "encoder.measured", "motor.voltage"]
needs_loop = pytest.mark.skipif(not compiled.available(), reason="the compiled loop was not built")
each_engine = pytest.mark.parametrize("engine", [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=needs_loop)])
Rig = Callable[[Engine], Simulation]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A motor, a hand and an encoder of its own rate, driven by a voltage from outside."""
    yield from _rigs(tmp_path_factory.mktemp("fmus"), ["motor.voltage"])


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """The same, driven by nothing."""
    yield from _rigs(tmp_path_factory.mktemp("fmus"), [])


def _rigs(folder: Path, stimulated: list[str]) -> Iterator[Rig]:
    models = {"motor": "dc_motor", "hand": "pendulum", "encoder": "daq"}
    links = [("hand.speed", "motor.speed"), ("motor.torque", "hand.torque"), ("hand.angle", "encoder.signal")]
    with ExitStack() as stack:
        files = {
            name: stack.enter_context(FmuFile(targets.build(model, folder / f"{name}.fmu")))
            for name, model in models.items()
        }

        def make(engine: Engine) -> Simulation:
            parts = {
                name: Part(file.interface, 4 * STEP if name == "encoder" else None) for name, file in files.items()
            }
            slaves = {name: Slave(file, name) for name, file in files.items()}
            system = wire(parts, links, stimulated)
            return stack.enter_context(Simulation(system, slaves, Timing(COUNT * STEP, STEP, engine=engine)))

        yield make


def voltage() -> FloatArray:
    return np.random.default_rng(1).normal(0.0, 0.01, COUNT + 1)


def live(
    simulation: Simulation, given: FloatArray, record: list[str], outputs: list[str], every: int = 1
) -> tuple[Result, Trace, FloatArray]:
    """Step through all values of the one input: the result, the record, and (K, m) the outputs after each step."""
    pieces: list[Trace] = []
    (name,) = map(str, simulation.system.stimulated)
    run = Run(PARAMETERS if name == "motor.voltage" else {}, {name: given[:1]}, record, record_every=every)
    under_way = simulation.live(run, outputs, pieces.append)
    seen = []
    for value in given[:-1]:
        under_way.given[0] = value
        under_way.step()
        seen.append(list(under_way.outputs))
    under_way.given[0] = given[-1]
    result = under_way.result()
    return result, joined(pieces), np.array(seen)


@each_engine
@pytest.mark.parametrize("every", [1, 3])
def test_changes_between_steps_leave_the_record_of_a_run_with_these_stimuli(
    rig: Rig, free: Rig, engine: Engine, every: int
) -> None:
    given = np.repeat(voltage()[:: COUNT // 20], COUNT // 20)[: COUNT + 1]
    expected = rig(engine).run(PARAMETERS, {"motor.voltage": given}, RECORD, record_every=every).trace
    pieces: list[Trace] = []
    run = free(engine).live(Run(PARAMETERS, {}, RECORD, record_every=every), [], pieces.append, ["motor.voltage"])
    for number, value in enumerate(given):
        if value != run.tuned.values["motor.voltage"]:
            run.change("motor.voltage", run.tuned.checked("motor.voltage", value), "a test")
        if number < COUNT:
            run.step()
        if number % 700 == 0:
            run.flush()
    changes = run.result().changes
    trace = joined(pieces)
    assert all(trace[name].tobytes() == expected[name].tobytes() for name in RECORD)
    steps = np.flatnonzero(np.diff(given, prepend=0.0))
    assert [change.step for change in changes] == steps.tolist()
    assert [change.time for change in changes] == [float(step * STEP) for step in steps]
    assert [change.value for change in changes] == given[steps].tolist()
    assert all(change.taken and change.by == "a test" for change in changes)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("motor.speed", 1.0, "motor.speed: is driven by something else; change what drives it"),
        ("motor.resistance", 1.0, "is a fixed parameter; only an input or a tunable one can be changed while it runs"),
        ("motor.voltag", 1.0, "did you mean 'voltage'"),
        ("motor.voltage", "3 N", "voltage"),
        ("motor.voltage", float("nan"), "is nan"),
    ],
)
def test_what_cannot_be_changed_is_refused(free: Rig, name: str, value: float | str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        free(Engine.PYTHON).live(Run(), [], lambda piece: None, [name]).tuned.checked(name, value)


@each_engine
@pytest.mark.parametrize("every", [1, 3])
def test_a_live_run_equals_the_run_with_the_same_stimuli_bit_for_bit(rig: Rig, engine: Engine, every: int) -> None:
    given = voltage()
    expected = rig(engine).run(PARAMETERS, {"motor.voltage": given}, RECORD, record_every=every)
    result, trace, _ = live(rig(engine), given, RECORD, [], every)
    assert trace.names == expected.trace.names and trace.units == expected.trace.units
    assert trace.time.tobytes() == expected.trace.time.tobytes()
    assert all(trace[name].tobytes() == expected.trace[name].tobytes() for name in trace.names)
    assert result.account.steps == expected.account.steps == COUNT
    assert result.account.reached == expected.account.reached
    assert {name: each.calls for name, each in result.statistics.items()} == {
        name: each.calls for name, each in expected.statistics.items()
    }


@each_engine
def test_outputs_of_dynamics_are_those_at_the_beginning_of_the_step(rig: Rig, engine: Engine) -> None:
    _, trace, seen = live(rig(engine), voltage(), ["hand.angle"], ["hand.speed", "hand.angle"])
    assert seen[:, 1].tobytes() == trace["hand.angle"][:-1].tobytes()
    assert np.ptp(seen[:, 0]) > 0


def test_outputs_of_a_sampler_react_to_the_inputs_of_the_step() -> None:
    given = np.arange(12.0)
    sampler = Sampler("law", np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.array([[2.0]]))
    _, _, seen = live(simulation([sampler], stimulated=["law.u0"]), given, ["law.y0"], ["law.y0"])
    assert seen[:, 0].tolist() == (2 * given[:-1]).tolist()


def test_a_closed_loop_over_the_outside_has_no_delay_but_that_of_the_outside() -> None:
    A, B, K, h = np.array([[0.0, 1.0], [-4.0, -0.5]]), np.array([[0.0], [1.0]]), 3.0, Fraction(1, 10)
    plant = Plant("plant", A, B, np.array([[1.0, 0.0]]), x0=[1.0, 0.0])
    pieces: list[Trace] = []
    under_way = simulation([plant], step=h, stimulated=["plant.u0"]).live(
        Run({}, {"plant.u0": np.zeros(1)}, []), ["plant.y0"], pieces.append
    )
    Ad, Bd = zero_order_hold(A, B, float(h))
    x, u = np.array([1.0, 0.0]), 0.0
    for _ in range(100):
        under_way.step()
        assert under_way.outputs[0] == pytest.approx(x[0], abs=1e-12)
        under_way.given[0] = -K * under_way.outputs[0]
        x, u = Ad @ x + Bd[:, 0] * u, -K * x[0]


def test_a_live_run_has_no_end() -> None:
    under_way = simulation([Gain("k", 2.0)], stop=Fraction(1, 2), stimulated=["k.u0"]).live(
        Run({}, {"k.u0": np.ones(1)}), ["k.y0"], lambda piece: None
    )
    for _ in range(20):
        under_way.step()
    assert under_way.time == 2.0
    assert under_way.result().account.reached == 2.0


def test_a_system_without_inputs_can_be_stepped_too() -> None:
    plant = Plant("plant", np.array([[-1.0]]), np.zeros((1, 0)), np.eye(1), x0=[1.0])
    under_way = simulation([plant]).live(Run(), ["plant.y0"], lambda piece: None)
    under_way.step()
    under_way.step()
    assert under_way.outputs[0] == pytest.approx(np.exp(-0.1), abs=1e-12)
    assert under_way.inputs == () and len(under_way.given) == 0


def test_a_failure_leaves_the_record_of_the_whole_steps() -> None:
    plant = Plant("plant", np.array([[-1.0]]), np.ones((1, 1)), np.eye(1))
    plant.fail_at = 7
    pieces: list[Trace] = []
    under_way = simulation([plant], stimulated=["plant.u0"]).live(
        Run({}, {"plant.u0": np.ones(1)}), ["plant.y0"], pieces.append
    )
    with pytest.raises(FmuError, match="plant: step from"):
        _step_for_ever(under_way)
    result = under_way.result()
    assert result.account.steps == under_way.steps == 7
    assert sum(map(len, pieces)) == 7


def test_the_same_components_can_be_run_again_from_the_start(rig: Rig) -> None:
    given, again = voltage()[:50], rig(Engine.AUTO)
    _, first, _ = live(again, given, RECORD, [])
    _, second, _ = live(again, given, RECORD, [])
    assert all(first[name].tobytes() == second[name].tobytes() for name in RECORD)


@pytest.mark.parametrize(
    ("outputs", "stimuli", "message"),
    [
        (["k.y1"], {"k.u0": np.ones(1)}, "k.y1: no variable 'y1' in 'k'; there are u0, y0"),
        (["k.y0"], {}, "stimuli: [] given; give ['k.u0']"),
        (["k.y0"], {"k.u0": np.array([np.nan])}, "k.u0: is driven by a sample that is not finite; repair the stimulus"),
    ],
)
def test_what_does_not_fit_is_refused(outputs: list[str], stimuli: dict[str, FloatArray], message: str) -> None:
    with pytest.raises(WiringError) as refused:
        simulation([Gain("k", 1.0)], stimulated=["k.u0"]).live(Run({}, stimuli), outputs, lambda piece: None)
    assert str(refused.value) == message


def _step_for_ever(under_way: LiveRun[Result]) -> None:
    while True:
        under_way.step()
