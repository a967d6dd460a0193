"""Iterated steps are the trapezoidal rule between components; with a tolerance their error is what was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

from fmus.errors import FmuError, WiringError
from orchestrator.engine import REFUSED, CycleSettings, Order, Result, Simulation, StepControl, Timing
from orchestrator.trace import FloatArray
from tests.support.simulation.scripted import Gain, Plant, Sampler, Scripted, system

CYCLES = CycleSettings(tolerance=1e-13, limit=50)


def run(
    parts: Sequence[Scripted],
    wires: Sequence[str],
    step: str,
    stop: str = "1",
    control: StepControl | None = None,
    **more: object,
) -> Result:
    timing = Timing(Fraction(stop), Fraction(step), Fraction(0), Order.ITERATED, CYCLES, control=control)
    components = {part.name: part for part in parts}
    return Simulation(system(parts, wires), components, replace(timing, **more)).run()  # type: ignore[arg-type]


def spring(stiffness: float = 9.0, damping: float = 0.0) -> Plant:
    """From the speed of its end to the force in it; y1 its stretch."""
    return Plant("spring", [[0.0]], [[1.0]], [[stiffness], [1.0]], [[damping], [0.0]], [0.3])


def mass(kilograms: float = 1.0, name: str = "mass") -> Plant:
    """From a force against it to its speed."""
    return Plant(name, [[0.0]], [[-1.0 / kilograms]], [[1.0]])


OSCILLATOR = ["spring.y0 -> mass.u0", "mass.y0 -> spring.u0"]


def energy(result: Result, stiffness: float = 9.0, kilograms: float = 1.0) -> FloatArray:
    found = 0.5 * kilograms * result.trace["mass.y0"] ** 2 + 0.5 * stiffness * result.trace["spring.y1"] ** 2
    return np.asarray(found)


@pytest.mark.parametrize("step", ["1/10", "1/50"])
def test_a_spring_and_a_mass_keep_their_energy(step: str) -> None:
    kept = energy(run([spring(), mass()], OSCILLATOR, step, "20"))
    assert np.ptp(kept) < 1e-10 * kept[0]
    timing = Timing(Fraction(20), Fraction(step))
    lost = energy(
        Simulation(system([spring(), mass()], OSCILLATOR), {"spring": spring(), "mass": mass()}, timing).run()
    )
    assert np.ptp(lost) > 1e-2 * lost[0]


def test_iterated_steps_are_the_trapezoidal_rule() -> None:
    result = run([spring(9.0, 0.4), mass()], OSCILLATOR, "1/10", "3")
    A, h = np.array([[0.0, 1.0], [-9.0, -0.4]]), 0.1
    once = np.linalg.solve(np.eye(2) - h / 2 * A, np.eye(2) + h / 2 * A)
    states = [np.array([0.3, 0.0])]
    for _ in range(30):
        states.append(once @ states[-1])
    found = np.stack([result.trace["spring.y1"], result.trace["mass.y0"]], axis=1)
    assert np.abs(found - states).max() < 1e-11


def test_the_error_falls_with_the_square_of_the_step() -> None:
    A = np.array([[0.0, 1.0], [-9.0, -0.4]])
    exact = (scipy.linalg.expm(2 * A) @ [0.3, 0.0])[0]
    steps = ["1/40", "1/80", "1/160"]
    errors = [
        abs(run([spring(9.0, 0.4), mass()], OSCILLATOR, step, "2").trace["spring.y1"][-1] - exact) for step in steps
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.05)


def test_what_is_not_coupled_in_a_circle_is_a_chain_of_means() -> None:
    source = Plant("source", [[0.0]], [[0.0]], [[1.0]], x0=[1.0])
    chain = [source, Gain("gain", 2.0), Plant("sink", [[0.0]], [[1.0]], [[1.0]])]
    result = run(chain, ["source.y0 -> gain.u0", "gain.y0 -> sink.u0"], "1/4")
    assert result.trace["sink.y0"].tolist() == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])


def test_a_step_that_does_not_settle_is_an_error_that_names_the_way_out() -> None:
    with pytest.raises(FmuError) as failed:
        run([spring(1e6), mass()], OSCILLATOR, "1/10")
    assert "spring, mass: the step from t = 0 s did not settle in 50 iterations" in str(failed.value)
    assert "give it a `tolerance`" in str(failed.value)


def control(tolerance: float, least: str = "1/1000000") -> StepControl:
    return StepControl(tolerance, Fraction(least))


def test_a_stiff_circle_settles_where_its_steps_are_shortened() -> None:
    result = run([spring(1e4), mass()], OSCILLATOR, "1/10", "1/5", control(1e-2))
    kept = energy(result, 1e4)
    assert np.ptp(kept) < 1e-9 * kept[0]
    assert result.account.taken is not None and result.account.taken.shortest < 0.02  # 2 over its frequency
    assert result.account.taken.rejected > 0 and result.account.taken.forced == 0


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_the_error_is_of_the_size_that_was_asked_for(tolerance: float) -> None:
    A = np.array([[0.0, 1.0], [-9.0, -0.4]])
    result = run([spring(9.0, 0.4), mass()], OSCILLATOR, "1/2", "2", control(tolerance))
    exact = np.array([scipy.linalg.expm(time * A) @ [0.3, 0.0] for time in result.trace.time])
    found = np.stack([result.trace["spring.y1"], result.trace["mass.y0"]], axis=1)
    taken = result.account.taken
    assert taken is not None
    assert np.abs(found - exact).max() < tolerance * taken.steps  # what each step may add
    assert result.trace.time.tolist() == [0.5 * number for number in range(5)]


def test_of_large_values_the_tolerance_is_a_share() -> None:
    found = []
    for size in (1e3, 1e4):
        stretched = Plant("spring", [[0.0]], [[1.0]], [[9.0], [1.0]], [[0.4], [0.0]], [size])
        found.append(run([stretched, mass()], OSCILLATOR, "1/2", "2", control(1e-4)).account.taken)
    assert found[0] == found[1]


@pytest.mark.slow
def test_fewer_steps_are_taken_where_a_system_is_at_rest() -> None:
    damped = [spring(100.0, 4.0), mass()]
    beginning = run(damped, OSCILLATOR, "1", "2", control(1e-4)).account.taken
    whole = run(damped, OSCILLATOR, "1", "12", control(1e-4)).account.taken
    assert beginning is not None and whole is not None
    assert (whole.steps - beginning.steps) / 10 < 0.5 * beginning.steps / 2


def test_steps_that_cannot_be_short_enough_count_and_are_told(caplog: pytest.LogCaptureFixture) -> None:
    result = run([spring(100.0), mass()], OSCILLATOR, "1/10", "1", control(1e-9, "1/40"))
    assert result.account.taken is not None and result.account.taken.forced == 20
    assert caplog.text.count("the error of a step is larger than the tolerance") == 1


def test_sampled_parts_act_over_the_step_that_they_sample() -> None:
    plant = Plant("plant", [[-1.0]], [[1.0]], [[1.0]], x0=[1.0])
    wires = ["plant.y0 -> sampler.u0", "sampler.y0 -> plant.u0"]
    sampler = Sampler("sampler", [[0.0]], [[0.0]], [[0.0]], [[-0.5]])
    ports = {name: replace(port, variability="discrete") for name, port in sampler.interface.ports.items()}
    sampler.interface = replace(sampler.interface, ports=ports)
    parts = [sampler, plant]
    one = run(parts, wires, "1/10")
    timing = Timing(Fraction(1), Fraction(1, 10), cycles=REFUSED)
    other = Simulation(system(parts, wires), {part.name: part for part in parts}, timing).run()
    assert one.trace["plant.y0"].tolist() == pytest.approx(other.trace["plant.y0"].tolist(), abs=1e-12)


def test_components_that_cannot_go_back_are_refused() -> None:
    stuck = spring()
    stuck.interface = replace(stuck.interface, has_state=False)
    with pytest.raises(WiringError, match="spring: cannot go back, and iterated steps are taken back; its FMU needs"):
        run([stuck, mass()], OSCILLATOR, "1/10")


@pytest.mark.parametrize(
    ("able", "problem"),
    [
        ({"variable_step": False}, "spring: takes steps of one length only, and `step` has a tolerance; its FMU needs"),
        (
            {"fixed_step": 0.01},
            r"spring\.step: .* s, to which steps may be halved, is no multiple of the FMU's own 0\.01 s",
        ),
    ],
)
def test_components_that_cannot_take_shorter_steps_are_refused(able: dict[str, object], problem: str) -> None:
    rigid = spring()
    rigid.interface = replace(rigid.interface, **able)  # type: ignore[arg-type]
    with pytest.raises(WiringError, match=problem):
        run([rigid, mass()], OSCILLATOR, "1/10", control=control(1e-4))
    rigid.interface = replace(rigid.interface, variable_step=True)
    run([rigid, mass()], OSCILLATOR, "8/100", "8/10", StepControl(1e-4, Fraction(1, 100)))
