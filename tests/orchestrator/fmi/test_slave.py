"""One running FMU of either version: the trajectories of FMPy, every type there and back, and every failure named."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest
import scipy.linalg

from fmus.errors import FmuError, FmuFileError, WiringError
from fmus.packaging import targets
from orchestrator.engine import CycleSettings, Order, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part, wire
from orchestrator.trace import Trace
from tests.support import moody, third_party

Load = Callable[[Path, str], Slave]


@pytest.fixture
def load() -> Iterator[Load]:
    """Opens FMUs as slaves, and closes them after the test."""
    with ExitStack() as stack:

        def opened(path: Path, name: str = "fmu") -> Slave:
            slave = Slave(stack.enter_context(FmuFile(path)), name)
            stack.callback(slave.close)
            return slave

        yield opened  # type: ignore[misc]


@pytest.fixture(scope="module")
def moody_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moody.build(tmp_path_factory.mktemp("moody"))


def run(
    paths: Mapping[str, Path],
    links: Sequence[tuple[str, str]] = (),
    *,
    step: Fraction,
    stop: Fraction,
    values: Mapping[str, Value] | None = None,
    stimuli: Mapping[str, np.ndarray] | None = None,
) -> Trace:
    """Outputs of these FMUs."""
    with ExitStack() as stack:
        files = {name: stack.enter_context(FmuFile(path)) for name, path in paths.items()}
        system = wire({name: Part(file.interface) for name, file in files.items()}, links, stimuli or {})
        slaves = {name: Slave(file, name) for name, file in files.items()}
        made = stack.enter_context(Simulation(system, slaves, Timing(stop, step)))
        return made.run(values, stimuli).trace


TRAJECTORIES = [
    ("VanDerPol", ("x0", "x1"), Fraction(1, 10), Fraction(20), {}),
    ("VanDerPol", ("x0", "x1"), Fraction(1, 100), Fraction(5), {"mu": 3.0, "x0": -1.0}),
    ("Dahlquist", ("x",), Fraction(1, 10), Fraction(10), {"k": 2.0}),
    ("BouncingBall", ("h", "v"), Fraction(1, 100), Fraction(3), {"e": 0.8}),
    ("Stair", ("counter",), Fraction(1, 5), Fraction(8), {}),
]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("model", "outputs", "step", "stop", "values"), TRAJECTORIES)
def test_reference_fmus_run_as_in_fmpy(
    version: int, model: str, outputs: tuple[str, ...], step: Fraction, stop: Fraction, values: dict[str, float]
) -> None:
    path = third_party.reference(version, model)
    trace = run({"fmu": path}, step=step, stop=stop, values={f"fmu.{n}": v for n, v in values.items()})
    judge = fmpy.simulate_fmu(
        str(path),
        stop_time=float(stop),
        output_interval=float(step),
        step_size=float(step),
        start_values=values,
        output=outputs,
        fmi_type="CoSimulation",
        validate=False,
        set_stop_time=False,
    )
    assert len(judge) == len(trace)
    for name in outputs:
        assert np.abs(trace[f"fmu.{name}"] - judge[name]).max() <= 1e-12
        assert np.ptp(judge[name]) > 0


@pytest.mark.parametrize("version", [2, 3])
def test_feedthrough_passes_stimuli_through_as_in_fmpy(version: int) -> None:
    path = third_party.reference(version, "Feedthrough")
    time = np.arange(21) / 10
    signal = np.sin(time)
    stimuli = {
        "fmu.Float64_continuous_input": signal,
        "fmu.Int32_input": np.floor(5 * time),
        "fmu.Boolean_input": (time > 1).astype(float),
    }
    trace = run({"fmu": path}, step=Fraction(1, 10), stop=Fraction(2), stimuli=stimuli)
    assert np.array_equal(trace["fmu.Float64_continuous_output"][1:], signal[:-1])  # left limits
    assert np.array_equal(trace["fmu.Int32_output"][1:], np.floor(5 * time)[:-1])
    assert np.array_equal(trace["fmu.Boolean_output"][1:], time[:-1] > 1)


FMI2_VALUES: dict[str, Value] = {
    "Float64_continuous": -1.5e-300,
    "Float64_discrete": 1e308,
    "Int32": -(2**31),
    "Boolean": True,
    "String": "Grüße, 世界",
    "Enumeration": 2,
}
FMI3_VALUES: dict[str, Value] = {
    **FMI2_VALUES,
    "Float32_continuous": 0.1,
    "Float32_discrete": -3.0e38,
    **{f"Int{bits}": -(2 ** (bits - 1)) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": 2**bits - 1 for bits in (8, 16, 32, 64)},
}


@pytest.mark.parametrize(
    ("version", "kind", "value"),
    [(2, *item) for item in FMI2_VALUES.items()] + [(3, *item) for item in FMI3_VALUES.items()],
)
def test_every_scalar_type_is_written_and_read_back(version: int, kind: str, value: Value, load: Load) -> None:
    slave = load(third_party.reference(version, "Feedthrough"), "fmu")
    slave.set({f"{kind}_input": value})
    slave.begin(0.0, None)
    slave.run()
    slave.step(0.0, 0.1)
    got = slave.get(f"{kind}_output")
    assert got == (pytest.approx(value, rel=1e-7) if kind.startswith("Float32") else value)
    assert type(got) is type(value)


@pytest.mark.parametrize(("version", "prefix"), [(2, ""), (3, "")])
def test_numbers_of_all_types_travel_together(version: int, prefix: str, load: Load) -> None:
    slave = load(third_party.reference(version, "Feedthrough"), "fmu")
    values = FMI2_VALUES if version == 2 else FMI3_VALUES
    kinds = [kind for kind in values if kind != "String"][::-1]
    slave.bind([f"{kind}_input" for kind in kinds], [f"{kind}_output" for kind in kinds])
    slave.begin(0.0, None)
    slave.run()
    slave.write([float(values[kind]) if kind != "UInt64" else 2.0**63 for kind in kinds])
    slave.step(0.0, 0.1)
    expected = [2.0**63 if kind == "UInt64" else float(values[kind]) for kind in kinds]
    assert list(slave.read()) == pytest.approx(expected, rel=1e-7)


def test_items_of_an_enumeration_can_be_set_by_name(load: Load) -> None:
    for version in (2, 3):
        slave = load(third_party.reference(version, "Feedthrough"), f"fmi{version}")
        slave.set({"Enumeration_input": "Option 2"})
        slave.begin(0.0, None)
        assert slave.get("Enumeration_input") == 2


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("Enumeration_input", "Option 3", "cannot be 'Option 3'; give Option 1 (1), Option 2 (2)"),
        ("Enumeration_input", 3, "cannot be 3; give Option 1 (1), Option 2 (2)"),
        ("Float64_continuous_input", "fast", "cannot be 'fast'; give a Float64"),
        ("Int8_input", 1.5, "is of type Int8, 1.5 is not whole; give a whole number"),
        ("Int8_input", float("nan"), "is of type Int8, nan is not whole; give a whole number"),
        ("Int8_input", 128, "128 does not fit into Int8 (-128 to 127); choose a value inside"),
        ("UInt64_input", -1, "-1 does not fit into UInt64 (0 to 18446744073709551615); choose a value inside"),
        ("Boolean_input", 2, "is a Boolean, not 2; give true or false"),
        ("Boolean_input", 0.5, "is a Boolean, not 0.5; give true or false"),
        ("nothing", 1, "no such variable; see `servotwin info`"),
    ],
)
def test_a_value_that_does_not_fit_its_type_is_refused(name: str, value: Value, problem: str, load: Load) -> None:
    slave = load(third_party.reference(3, "Feedthrough"), "fmu")
    with pytest.raises(FmuFileError) as refused:
        slave.set({name: value})
    assert str(refused.value) == f"fmu.{name}: {problem}"


def test_a_number_that_does_not_fit_the_connected_input_is_an_error_not_cut_off(load: Load) -> None:
    slave = load(third_party.reference(3, "Feedthrough"), "fmu")
    slave.bind(["Int8_input", "UInt8_input"], [])
    slave.begin(0.0, None)
    slave.run()
    with pytest.raises(FmuError, match=r"fmu: set inputs: 300.0 does not fit into Int8 \(-128 to 127\)"):
        slave.write([300.0, 0.0])
    with pytest.raises(FmuError, match="fmu: set inputs: "):
        slave.write([float("nan"), 0.0])


def test_types_that_are_not_numbers_stay_at_their_start_and_are_not_recorded() -> None:
    trace = run({"fmu": third_party.reference(3, "Feedthrough")}, step=Fraction(1, 10), stop=Fraction(1))
    assert "fmu.Float32_continuous_output" in trace.names
    assert not {"fmu.Binary_output", "fmu.String_output"} & set(trace.names)


def test_a_binary_variable_is_refused_with_its_type(load: Load) -> None:
    with pytest.raises(FmuFileError, match="type Binary, which is not supported"):
        load(third_party.reference(3, "Feedthrough"), "fmu").get("Binary_input")


def test_maplesims_coupled_clutches_run() -> None:
    trace = run({"c": third_party.coupled_clutches()}, step=Fraction(1, 100), stop=Fraction(3, 2))
    speeds = [trace[f"c.outputs[{i}]"] for i in range(1, 5)]
    assert [speed[0] for speed in speeds] == [10.0, 0.0, 0.0, 0.0]
    assert all(np.all(np.isfinite(speed)) for speed in speeds)
    late = slice(-20, None)
    assert speeds[1][late] == pytest.approx(speeds[2][late], abs=0.1)  # the second clutch has locked


def test_openmodelicas_fmi3_model_counts() -> None:
    path = third_party.fmi3_model()
    trace = run({"fmu": path}, step=Fraction(1, 10), stop=Fraction(1), values={"fmu.increment": 2.5})
    assert np.diff(trace["fmu.output"]) == pytest.approx(2.5)


def mass_spring(step: Fraction, stop: Fraction = Fraction(2)) -> tuple[Trace, Trace]:
    """The mass-spring system whole, and as two coupled subsystems."""
    whole = run({"fmu": third_party.mass_spring("System")}, step=step, stop=stop)
    coupled = run(
        {"one": third_party.mass_spring("SubSystem1"), "two": third_party.mass_spring("SubSystem2")},
        [("one.x1", "two.x1"), ("two.x2", "one.x2")],
        step=step,
        stop=stop,
    )
    return whole, coupled


def test_coupled_subsystems_are_the_monolithic_system() -> None:
    """OpenModelica's FMUs take explicit Euler steps, for which the coupling is no approximation."""
    whole, coupled = mass_spring(Fraction(1, 100))
    for one, name in (("one.x1", "x1"), ("one.v1", "v1"), ("two.x2", "x2"), ("two.v2", "v2")):
        assert np.abs(coupled[one] - whole[f"fmu.{name}"]).max() <= 1e-12


def test_coupled_subsystems_approach_the_exact_motion_with_order_one() -> None:
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.array([[-2.0, 1.0], [1.0, -2.0]]), np.zeros((2, 2))]])
    exact = (scipy.linalg.expm(2 * A) @ [0.0, 1.0, 1.0, 0.0])[0]  # unit masses and springs; x2 and v1 start at 1
    steps = [Fraction(1, 50 * 2**i) for i in range(3)]
    errors = [abs(mass_spring(step)[1]["one.x1"][-1] - exact) for step in steps]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_that_asks_to_stop_ends_the_run_in_good_order(version: int) -> None:
    trace = run({"fmu": third_party.reference(version, "Stair")}, step=Fraction(1, 5), stop=Fraction(20))
    assert trace.time[-1] == 9.0 and trace["fmu.counter"][-1] == 10


@pytest.mark.parametrize("version", [2, 3])
def test_calls_out_of_order_are_errors_with_the_fmus_own_words(version: int, load: Load) -> None:
    slave = load(third_party.reference(version, "Dahlquist"), "fmu")
    with pytest.raises(
        FmuError, match=rf"fmu: step from t = 0 s by 0.1 s: returned error \(fmi{version}DoStep: Illegal"
    ):
        slave.step(0.0, 0.1)
    slave.reset()
    slave.begin(0.0, None)
    with pytest.raises(FmuError, match=rf"fmu: enter initialisation: returned error \(fmi{version}.*: Illegal call"):
        slave.begin(0.0, None)


STATUS_NAMES = {2: "discard", 3: "error", 4: "fatal error", 5: "pending", 77: "77"}
ACTIONS = {
    "set": "set input = 2.0",
    "setup": "enter initialisation",
    "enter": "enter initialisation",
    "exit": "initialise",
    "step": "step from t = 0 s by 0.1 s",
    "get": "get get, input",  # read back when the initialisation is over
    "save": "save its state",
}


def life(slave: Slave, place: str, status: int) -> None:
    """Instantiate to first step, where one function returns this status."""
    slave.bind(["input"], ["output"])
    slave.set({place: status})
    slave.set({"input": 2.0})
    slave.begin(0.0, None)
    slave.run()
    slave.step(0.0, 0.1)
    slave.read()
    slave.save()


@pytest.mark.parametrize("place", ACTIONS)
@pytest.mark.parametrize("status", STATUS_NAMES)
def test_every_status_but_ok_and_warning_is_an_error_with_the_message_formatted(
    moody_fmu: Path, place: str, status: int, load: Load
) -> None:
    slave = load(moody_fmu, "fmu")
    with pytest.raises(FmuError) as failed:
        life(slave, place, status)
    said = f"{place} said {status}, 2.500 times no"
    deadly = place == "set" and status >= 4  # an FMU that may be asked no more does not say which value it was
    action = "set set, input" if deadly else ACTIONS[place]
    problem, fix = "", ""
    if (place, STATUS_NAMES[status]) == ("exit", "discard"):
        problem = ": there is no start from these values"
        fix = "; change its parameters, start values or first inputs"
    assert str(failed.value) == f"fmu: {action}: returned {STATUS_NAMES[status]}{problem} ({said}){fix}"
    assert failed.value.exit_code == 3


def test_a_failure_to_read_outputs_is_named(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    life(slave, "step", 0)
    slave.set({"get": 3})
    with pytest.raises(FmuError, match=r"fmu: get outputs: returned error \(get said 3, 2.500 times no\)"):
        slave.read()


def test_warnings_are_counted_and_logged_not_raised(
    moody_fmu: Path, load: Load, caplog: pytest.LogCaptureFixture
) -> None:
    slave = load(moody_fmu, "fmu")
    life(slave, "step", 1)
    assert slave.warnings == 1
    assert ("servotwin.fmu", logging.WARNING, "fmu: step said 1, 2.500 times no") in caplog.record_tuples
    slave.reset()
    assert slave.warnings == 0


@pytest.mark.parametrize("place", ACTIONS)
def test_after_a_fatal_error_no_function_of_the_fmu_is_called(moody_fmu: Path, place: str, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    with pytest.raises(FmuError, match="fatal"):
        life(slave, place, 4)
    slave.reset()
    life(slave, "step", 0)
    slave.close()
    assert moody.counter(slave, "calls_after_fatal") == 0


def test_closing_frees_the_instance_once(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    assert moody.counter(slave, "instances") == 1
    slave.close()
    slave.close()
    assert moody.counter(slave, "instances") == 0


def test_a_failure_to_instantiate_carries_the_fmus_message(moody_fmu: Path) -> None:
    with FmuFile(moody_fmu) as fmu, pytest.raises(FmuError) as failed:
        Slave(fmu, "_nobody")
    assert str(failed.value) == "_nobody: instantiate: Failed to instantiate model (no licence for '_nobody')"


def test_a_parameter_that_does_not_take_is_an_error(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    slave.set({"stubborn": 2.0})
    slave.begin(0.0, None)
    with pytest.raises(FmuError) as failed:
        slave.run()
    assert str(failed.value) == (
        "fmu.stubborn: was set to 2.0 but is 1.0; the FMU does not take it; remove it or ask the supplier"
    )


def test_a_failed_step_in_an_iteration_frees_its_snapshots_and_the_next_run_is_clean(moody_fmu: Path) -> None:
    with FmuFile(moody_fmu) as fmu:
        system = wire({"a": Part(fmu.interface)}, [("a.output", "a.input")])
        timing = Timing(Fraction(1), Fraction(1, 10), cycles=CycleSettings(iterate=True))
        with Simulation(system, {"a": Slave(fmu, "a")}, timing) as made:
            first = made.run().trace
            with pytest.raises(FmuError, match=r"a: step from t = 0 s by 0\.1 s: returned error"):
                made.run({"a.step": 3})
            assert np.array_equal(made.run().trace["a.output"], first["a.output"])


def test_messages_reach_their_own_instance_also_after_fmpy_ran_on_its_own(moody_fmu: Path, load: Load) -> None:
    one = load(moody_fmu, "one")
    fmpy.simulate_fmu(str(third_party.reference(2, "Dahlquist")), stop_time=0.1, logger=lambda *_: None)
    other = load(moody_fmu, "other")
    for slave, place in ((one, "step"), (other, "exit")):
        with pytest.raises(FmuError, match=rf"\({place} said 3, 2.500 times no\)"):
            life(slave, place, 3)


@pytest.mark.parametrize("version", [2, 3])
def test_a_saved_state_is_gone_back_to_exactly(version: int, load: Load) -> None:
    slave = load(third_party.reference(version, "VanDerPol"), "fmu")
    slave.bind([], ["x0", "x1"])
    slave.begin(0.0, None)
    slave.run()
    state = slave.save()
    ways = []
    for _ in range(3):
        slave.restore(state)
        for k in range(10):
            slave.step(k / 10, 0.1)
        ways.append(list(slave.read()))
    slave.drop(state)
    assert ways[0] == ways[1] == ways[2]


def own(folder: Path) -> Path:
    return targets.build("pendulum", folder / "pendulum.fmu", target="python")


def van_der_pol(version: int) -> Callable[[Path], Path]:
    return lambda folder: third_party.reference(version, "VanDerPol")


SETS: dict[str, tuple[Callable[[Path], Path], dict[str, Value], dict[str, Value]]] = {
    "own": (own, {"fmu.angle_start": 0.5}, {"fmu.added_mass": 0.1, "fmu.added_length": 0.1, "fmu.speed_start": 1.0}),
    "fmi2": (van_der_pol(2), {"fmu.mu": 2.0}, {"fmu.x0": 0.5}),
    "fmi3": (van_der_pol(3), {"fmu.mu": 2.0}, {"fmu.x0": 0.5}),
}


@pytest.mark.parametrize("kind", SETS)
def test_run_a_after_run_b_is_bitwise_run_a(kind: str, tmp_path: Path) -> None:
    source, a, b = SETS[kind]
    with FmuFile(source(tmp_path)) as fmu:
        system = wire({"fmu": Part(fmu.interface)}, [])
        with Simulation(system, {"fmu": Slave(fmu, "fmu")}, Timing(Fraction(1), Fraction(1, 100))) as made:
            first, other, again = made.run(a).trace, made.run(b).trace, made.run(a).trace
    for name in first.names:
        assert np.array_equal(first[name], again[name])
    assert any(not np.array_equal(first[name], other[name]) for name in first.names)


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("kind", SETS)
def test_memory_does_not_grow_over_two_thousand_resets(kind: str, tmp_path: Path) -> None:
    source, values, _ = SETS[kind]
    with FmuFile(source(tmp_path)) as fmu:
        system = wire({"fmu": Part(fmu.interface)}, [])
        with Simulation(system, {"fmu": Slave(fmu, "fmu")}, Timing(Fraction(2, 100), Fraction(1, 100))) as made:
            for _ in range(300):
                made.run(values)
            before = resident()
            for _ in range(2000):
                made.run(values)
            assert resident() - before < 512 * 1024


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("version", [2, 3])
def test_memory_does_not_grow_over_instances(version: int) -> None:
    with FmuFile(third_party.reference(version, "VanDerPol")) as fmu:

        def grown(count: int) -> int:
            """What so many instances leave behind [bytes]; the heap may grow once for other reasons."""
            before = resident()
            for _ in range(count):
                Slave(fmu, "fmu").close()
            return resident() - before

        grown(200)
        assert any(grown(1500) < 2 << 20 for _ in range(3))


def test_two_instances_of_one_fmu_do_not_share_values(load: Load, tmp_path: Path) -> None:
    with FmuFile(own(tmp_path)) as fmu:
        one, other = Slave(fmu, "one"), Slave(fmu, "other")
        one.set({"inertia": 0.5})
        assert (one.get("inertia"), other.get("inertia")) == (0.5, 0.00325)
        one.close()
        other.close()


def test_jacobi_and_gauss_seidel_agree_where_every_output_is_a_state(tmp_path: Path) -> None:
    """Uncoupled or coupled by states only, the order of components cannot matter."""
    traces = []
    for order in Order:
        with ExitStack() as stack:
            files = {f"{i}": stack.enter_context(FmuFile(third_party.mass_spring(f"SubSystem{i}"))) for i in (1, 2)}
            parts = {f"s{i}": Part(file.interface) for i, file in files.items()}
            system = wire(parts, [("s1.x1", "s2.x1"), ("s2.x2", "s1.x2")])
            slaves = {f"s{i}": Slave(file, f"s{i}") for i, file in files.items()}
            timing = Timing(Fraction(1), Fraction(1, 50), order=order)
            traces.append(stack.enter_context(Simulation(system, slaves, timing)).run().trace)
    assert np.array_equal(traces[0]["s1.x1"], traces[1]["s1.x1"])


def test_structural_parameters_of_one_run_are_refused_before_it() -> None:
    with pytest.raises(WiringError, match=r"fmu\.m: is 3 and cannot be 2 in one run only"):
        run({"fmu": third_party.reference(3, "StateSpace")}, step=Fraction(1), stop=Fraction(2), values={"fmu.m": 2})


def test_temporary_folders_are_gone_after_an_error(
    moody_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(FmuError):
        run({"a": moody_fmu, "b": moody_fmu}, step=Fraction(1, 10), stop=Fraction(1), values={"b.step": 3})
    assert list(tmp_path.iterdir()) == []
