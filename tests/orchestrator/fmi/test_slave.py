"""One running FMU of either version: the trajectories of FMPy, every type there and back, and every failure named."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest
import scipy.linalg

from fmus.errors import FmuError, FmuFileError, WiringError
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Order, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.simulation.slaves import Load, run
from tests.support.tools import third_party

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
    with pytest.raises(FmuFileError if name == "nothing" else WiringError) as refused:
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


def test_a_binary_variable_is_read_in_hexadecimal(load: Load) -> None:
    assert load(third_party.reference(3, "Feedthrough"), "fmu").get("Binary_input") == b"foo".hex()


def test_maplesims_coupled_clutches_run() -> None:
    trace = run({"c": third_party.coupled_clutches()}, step=Fraction(1, 100), stop=Fraction(3, 2))
    speeds = [trace[f"c.outputs[{i}]"] for i in range(1, 5)]
    assert [speed[0] for speed in speeds] == [10.0, 0.0, 0.0, 0.0]
    assert all(np.all(np.isfinite(speed)) for speed in speeds)
    late = slice(-20, None)
    assert speeds[1][late] == pytest.approx(speeds[2][late], abs=0.1)  # the second clutch has locked


@pytest.mark.slow
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


def test_jacobi_and_gauss_seidel_agree_where_every_output_is_a_state(tmp_path: Path) -> None:
    """Uncoupled or coupled by states only, the order of components cannot matter."""
    traces = []
    for order in (Order.GAUSS_SEIDEL, Order.JACOBI):
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
