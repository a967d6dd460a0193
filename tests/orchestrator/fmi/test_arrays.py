"""Array variables of FMI 3: their elements connect, are set and recorded, whatever their type and shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

from fmus.errors import FmuFileError, ServotwinError
from orchestrator.assembly.assembly import open_system
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Engine, Simulation, Timing, compiled
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.fmi.slave import Slave
from orchestrator.info import about
from orchestrator.scenario.run import parse_override, run_scenario
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.fmus import arrays
from tests.support.tools import third_party

pytestmark = pytest.mark.slow  # a compiler
ENGINES = [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=pytest.mark.skipif(not compiled.available(), reason="-"))]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return arrays.build(tmp_path_factory.mktemp("fmu"))


def run(
    path: Path,
    links: list[tuple[str, str]],
    values: Mapping[str, Value],
    engine: Engine = Engine.AUTO,
    sizes: Mapping[str, Value] | None = None,
) -> list[Trace]:
    """Traces of a and b, both of this FMU, run twice from reset."""
    with FmuFile(path, None, sizes) as file:
        system = wire({"a": Part(file.interface), "b": Part(file.interface)}, links)
        slaves = {"a": Slave(file, "a"), "b": Slave(file, "b")}
        with Simulation(system, slaves, Timing(Fraction(1), Fraction(1, 4), engine=engine)) as made:
            return [made.run(values).trace for _ in range(2)]


@pytest.mark.parametrize("engine", ENGINES)
def test_elements_of_every_type_connect_and_the_others_keep_what_they_were_given(path: Path, engine: Engine) -> None:
    """An array goes to the FMU as a whole: of each input of b one element is connected, the other set or at start."""
    kinds = [kind for kind in arrays.TYPES if kind not in ("String", "Enumeration", "Boolean")]
    links = [(f"a.out_{kind}[1]", f"b.in_{kind}[2]") for kind in [*kinds, "Boolean"]] + [("a.y[2]", "b.u[1]")]
    values: dict[str, Value] = {f"a.p_{kind}[1]": 5 for kind in kinds} | {f"b.in_{kind}[1]": 7 for kind in kinds[::2]}
    values |= {"b.in_Boolean[1]": True, "b.u[2]": 0.25, "b.gain[1,2]": 2.0, "b.in_Enumeration[2]": "none"}
    first, again = run(path, links, values, engine)
    for trace in (first, again):
        for number, kind in enumerate(kinds):
            found = [trace[f"b.out_{kind}[{place}]"][-1] for place in (1, 2)]
            assert found == [0.0 if number % 2 else 7.0, 5.0], kind
        assert [trace[f"b.out_Boolean[{place}]"][-1] for place in (1, 2)] == [1.0, 0.0]
        assert [trace[f"b.out_Enumeration[{place}]"][-1] for place in (1, 2)] == [1.0, 0.0]
        assert [trace[f"b.y[{place}]"][-1] for place in (1, 2)] == [2.0 + 2 * 0.25, 0.25]


@pytest.mark.parametrize("engine", ENGINES)
def test_whole_arrays_connect_element_by_element(path: Path, engine: Engine) -> None:
    first, _ = run(path, [("a.y", "b.u"), ("a.out_Int8", "b.in_Int8")], {"a.u[2]": 5.0, "a.p_Int8[2]": 3}, engine)
    assert [first[f"b.y[{place}]"][-1] for place in (1, 2)] == [1.0, 5.0]
    assert [first[f"b.out_Int8[{place}]"][-1] for place in (1, 2)] == [0.0, 3.0]


def test_arrays_of_different_shapes_do_not_connect(path: Path, tmp_path: Path) -> None:
    text = f"components:\n  a: {{fmu: {path}, parameters: {{m: 3}}}}\n  b: {{fmu: {path}}}\nconnections: [a.y -> b.u]\n"
    found = refusal(lambda: run_scenario(scenario(tmp_path, text)))
    assert "a.y -> b.u: joins an array of 3 elements to one of 2; connect elements" in found


@pytest.mark.parametrize("engine", ENGINES)
def test_what_was_given_in_one_run_is_gone_in_the_next(path: Path, engine: Engine) -> None:
    links = [("a.y[1]", "b.u[1]")]
    with FmuFile(path) as file:
        slaves = {"a": Slave(file, "a"), "b": Slave(file, "b")}
        system = wire({"a": Part(file.interface), "b": Part(file.interface)}, links)
        with Simulation(system, slaves, Timing(Fraction(1), Fraction(1, 4), engine=engine)) as made:
            ends = [made.run(values).trace["b.y[2]"][-1] for values in ({}, {"b.u[2]": 9.0}, {})]
    assert ends == [2.0, 9.0, 2.0]


def test_structural_parameters_change_shapes(path: Path) -> None:
    """Elements that have neither a value nor a start value keep what the FMU gives them: 3, 4 of its own inputs."""
    gain = {f"b.gain[{i},{j}]": float(10 * i + j) for i in (1, 2, 3) for j in (1, 2, 3)}
    for trace in run(path, [("a.y[1]", "b.u[2]")], {**gain, "b.m": 3, "b.u[1]": 1.0}, sizes={"m": 3}):
        assert [name for name in trace.names if name.startswith("b.y")] == ["b.y[1]", "b.y[2]", "b.y[3]"]
        u = np.array([1.0, 1.0, 3.0])  # a's gain has 1 in its first place
        assert [trace[f"b.y[{i}]"][-1] for i in (1, 2, 3)] == [
            np.array([10 * i + 1, 10 * i + 2, 10 * i + 3]) @ u for i in (1, 2, 3)
        ]


def scenario(folder: Path, text: str, step: float = 0.5) -> Path:
    file = folder / "arrays.yaml"
    file.write_text(f"title: arrays\nrun: {{stop: {2 * step}, step: {step}}}\n" + text)
    return file


def refusal(work: Callable[[], Any]) -> str:
    with pytest.raises(ServotwinError) as refused:
        work()
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_a_file_gives_arrays_whole_and_options_give_elements_and_sizes(path: Path, tmp_path: Path) -> None:
    parameters = (
        "{m: 3, gain: [[1, 0, 0], [0, 2, 0], [1, 1, 1]], u: [1, 2, 3], p_String: [x, y], p_Enumeration: [low, 3]}"
    )
    text = f"components:\n  c: {{fmu: {path}, parameters: {parameters}}}\n"
    text += "expect:\n- {signal: 'c.y[3]', near: 6, within: 0, after: 1}\n"
    assert run_scenario(scenario(tmp_path, text)).passed
    assert not run_scenario(scenario(tmp_path, text), {"c.gain[3,3]": 2.0}).passed
    cases = text + "cases:\n- {name: one, set: {c.u: [0, 0, 6]}}\n- {name: two, set: {c.u: [0, 0]}}\n"
    assert "c.u: is given as 2 elements and is 3 elements" in refusal(lambda: run_scenario(scenario(tmp_path, cases)))
    assert "c.gain: is given as 3 x 3 and is 2 x 2" in refusal(
        lambda: run_scenario(scenario(tmp_path, text), {"c.m": 2})
    )


def test_options_give_arrays_whole_and_as_the_type_of_the_variable_has_it(path: Path, tmp_path: Path) -> None:
    file = scenario(tmp_path, f"components: {{c: {{fmu: {path}}}}}\nrecord: [c.y, 'c.y[1]']\n")
    options = ["c.gain=[[1, 2], [3, 4e0]]", "c.p_String=[1e3, true]", "c.p_Boolean[1]=TRUE", "c.p_Int8=[1, 2]"]
    result = run_scenario(file, dict(map(parse_override, options)))
    assert list(result.cases[0].trace.names) == ["c.y[1]", "c.y[2]"]
    assert [result.cases[0].trace[f"c.y[{i}]"][-1] for i in (1, 2)] == [1 * 1 + 2 * 2, 3 * 1 + 4 * 2]
    assert result.overrides["c.p_String[1]"] == "1e3" and result.overrides["c.p_String[2]"] == "true"
    assert result.overrides["c.gain[2,2]"] == 4.0 and result.overrides["c.p_Boolean[1]"] is True
    for option, problem in {
        "c.gain=[[1, 2]]": "c.gain: is given as 1 x 2 and is 2 x 2",
        "c.gain=[[1, 2], [3]]": "the rows of 'c.gain' differ in length",
        "c.gain=[]": "'[]' is no array of anything",
        "c.gain=[[1, 2], 3": "c.gain: is an array of 2 x 2 elements; name one",
        "c.p_Int8=[1, x]": "c.p_Int8[2]: cannot be 'x'",
    }.items():
        told = refusal(lambda option=option: run_scenario(file, dict([parse_override(option)])))  # type: ignore[misc]
        assert problem in told, told


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ("{gain: [[1, 0], [0]]}", "the rows of 'gain' differ in length"),
        ("{gain: [1, [2]]}", "the rows of 'gain' differ in length"),
        ("{gain: [[1, null], [2, 3]]}", "'gain' holds something that is neither a number nor text"),
        ("{gain: [1, 0, 0, 1]}", "c.gain: is given as 4 elements and is 2 x 2"),
        ("{y: [1, 0]}", "c.y[1]: is an output and cannot be set"),
        ("{m: [1, 0]}", "c.m: is no array"),
        ("{y: 1}", "c.y: is an array of 2 elements; name one, as c.y[1]"),
        ("{m: 5}", "m: is 5, outside its bounds [1, 4]"),
        ("{m: 1.5}", "m: is of type UInt64, 1.5 is not whole"),
        ("{'gain[3,1]': 1}", "no variable 'gain[3,1]' in 'c'"),
        ("{'p_Int8[1]': 1.5}", "c.p_Int8[1]: is of type Int8, 1.5 is not whole"),
        ("{'p_UInt8[2]': 256}", "c.p_UInt8[2]: 256 does not fit into UInt8 (0 to 255)"),
        ("{p_Boolean: [true, 0.5]}", "c.p_Boolean[2]: is a Boolean, not 0.5"),
        ("{p_Enumeration: [2, 1]}", "c.p_Enumeration[1]: cannot be 2; give none (0), low (1), high (3)"),
        (
            "{p_Enumeration: [low, highest]}",
            "c.p_Enumeration[2]: cannot be 'highest'; give none (0), low (1), high (3)",
        ),
    ],
)
def test_values_that_do_not_fit_are_refused_by_file_and_name(
    path: Path, tmp_path: Path, parameters: str, problem: str
) -> None:
    text = f"components:\n  c: {{fmu: {path}, parameters: {parameters}}}\n"
    told = refusal(lambda: run_scenario(scenario(tmp_path, text)))
    assert problem in told and told.startswith(f"{tmp_path / 'arrays.yaml'}")


def test_a_size_is_the_same_in_all_cases(path: Path, tmp_path: Path) -> None:
    text = f"components:\n  c: {{fmu: {path}}}\ncases:\n- {{name: one, set: {{c.m: 3}}}}\n"
    assert "c.m: is 2 and cannot be 3 in one run only" in refusal(lambda: run_scenario(scenario(tmp_path, text)))


def test_one_start_value_is_that_of_all(tmp_path: Path) -> None:
    with FmuFile(arrays.build(tmp_path, ('start="1 0 0 1"', 'start="2"'))) as file:
        assert [port.start for port in file.interface.ports.values() if port.name.startswith("gain")] == ["2"] * 4


def test_arrays_are_the_same_in_model_exchange_and_in_a_process_of_their_own(tmp_path: Path) -> None:
    """x' = -x + 2 u from 1, y = x, sizes by structural parameters; the solver knows nothing of arrays."""
    path = third_party.reference(3, "StateSpace")
    values = "{m: 1, n: 1, r: 1, A: [[-1]], B: [[2]], C: [[1]], D: [[0]], x0: [1], u: [1]}"
    text = f"components:\n  c: {{fmu: {path}, parameters: {values}}}\n"
    exchanged = text.replace("parameters", "solver: {relative_tolerance: 1.0e-10}, parameters")
    by_itself = run_scenario(scenario(tmp_path, text, 1)).cases[0].trace["c.y[1]"]
    isolated = run_scenario(scenario(tmp_path, text, 1), isolation=Isolation()).cases[0].trace["c.y[1]"]
    solved = run_scenario(scenario(tmp_path, exchanged, 1)).cases[0].trace
    assert np.array_equal(by_itself, isolated)
    x0 = solved["c.y[1]"][0]  # this version of the FMU begins at 0 whatever x0 says
    assert solved["c.y[1]"] == pytest.approx(2 + (x0 - 2) * np.exp(-solved.time), rel=1e-7)


def test_state_space_is_what_fmpy_makes_of_it() -> None:
    """Whole arrays as FMPy sets them against elements, in the loop that steps them; to the last bit."""
    path = third_party.reference(3, "StateSpace")
    A, u = np.array([[0.5, 0.1, 0], [0, -1, 0.25], [0.5, 0, -2]]), [1.0, 0.0, 3.0]
    theirs = simulate_fmu(
        str(path), stop_time=5, output_interval=1, fmi_type="CoSimulation", start_values={"A": A.ravel(), "u": u}
    )
    values = {f"c.A[{i + 1},{j + 1}]": float(A[i, j]) for i in range(3) for j in range(3)} | {"c.u[2]": 0.0}
    with FmuFile(path) as file:
        system = wire({"c": Part(file.interface)}, [])
        with Simulation(system, {"c": Slave(file, "c")}, Timing(Fraction(5), Fraction(1))) as made:
            ours = made.run(values).trace
    assert np.array_equal(np.column_stack([ours[f"c.y[{i}]"] for i in (1, 2, 3)]), theirs["y"])


def test_arrays_with_too_many_elements_are_left_out_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = '<Float64 name="image" valueReference="95" causality="input" start="0"><Dimension start="2000"/>'
    path = arrays.build(tmp_path, ('<Float64 name="y"', f'{image}<Dimension start="1000"/></Float64><Float64 name="y"'))
    document: Any = about(path)
    assert document["left out"] == [{"name": "image", "why": "an array of 2000 x 1000 elements"}]
    text = f"components:\n  large: {{fmu: {path}}}\n"
    assert run_scenario(scenario(tmp_path, text)).cases[0].trace["large.y[2]"][-1] == 2.0
    assert "large: leaves out image" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('<Dimension start="2"/>', '<Dimension start="0"/>', "is an array of 0 elements; ask its supplier"),
        ('variability="fixed" start="2" min="1"', 'variability="fixed" start="0"', "is an array of 0 x 0 elements"),
        (
            'name="u" valueReference="3"',
            'name="u" valueReference="4"',
            "y: has the value reference 4 of u, and they are two",
        ),
    ],
)
def test_arrays_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, problem: str) -> None:
    with pytest.raises(FmuFileError, match=problem):
        about(arrays.build(tmp_path, (old, new)))


def test_info_shows_elements_and_sizes(path: Path, tmp_path: Path) -> None:
    long = '<Float64 name="long" valueReference="95" causality="input" start="0"><Dimension start="1000"/></Float64>'
    large: Any = about(arrays.build(tmp_path, ('<Float64 name="y"', f'{long}<Float64 name="y"')))
    assert "long[1] to long[1000]" in [entry["name"] for entry in large["inputs"]] and len(large["inputs"]) < 30
    document: Any = about(path)
    assert [entry["name"] for entry in document["inputs"][:2]] == ["u[1]", "u[2]"]
    assert {"name": "m", "start": "2", "unit": "", "description": ""} in document["structural parameters"]


@pytest.mark.parametrize("streamed", [False, True])
def test_whole_numbers_that_doubles_round_are_told(
    path: Path, caplog: pytest.LogCaptureFixture, streamed: bool
) -> None:
    said = "c.out_UInt64[2], c.out_Int64[1]: whole numbers beyond 2^53 are rounded, as doubles are"
    record = ["c.out_UInt64[1]", "c.out_UInt64[2]", "c.out_Int64[1]", "c.out_Int32[1]", "c.y[1]"]
    pieces: list[Trace] = []
    timing = Timing(Fraction(1), Fraction(1, 4))
    with open_system({"c": path}) as opened, opened.simulation(timing) as simulation:
        for small in (False, True):
            values = {"c.p_UInt64[2]": 5 if small else (1 << 53) + 1, "c.p_Int64[1]": 5 if small else -(1 << 60)}
            caplog.clear()
            simulation.run(values, record=record, sink=pieces.append if streamed else None)
            assert (said in caplog.text) == (not small)
