"""The linear model against its recursion in NumPy, in every packaging, and as a plant in a loop."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.errors import FmuFileError, ModelError
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance
from fmus.models.plants.state_space import matrices, state_space
from fmus.packaging import archive, linear
from fmus.packaging.native import compiler
from fmus.parameters import write_back
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import FloatArray
from tests.support.fmus.either import opened

PACKAGINGS = [("python", 2), *([("native", 2), ("native", 3)] if compiler.available() else [])]


@dataclass(frozen=True)
class Linear:
    """A linear model as the builder wants it."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    step: float = 0.01
    inputs: tuple[str, ...] = ("u", "v")
    outputs: tuple[str, ...] = ("y", "z")

    def simulated(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """(K, p) outputs under inputs (K, m)."""
        x = np.zeros(len(self.a)) if start is None else start
        rows = []
        for row in u:
            rows.append(self.c @ x + self.d @ row)
            x = self.a @ x + self.b @ row
        return np.array(rows)


def random_linear(order: int, seed: int, direct: bool = False) -> Linear:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((order, order))
    a *= 0.95 / max(abs(np.linalg.eigvals(a)))
    d = rng.standard_normal((2, 2)) if direct else np.zeros((2, 2))
    return Linear(a, rng.standard_normal((order, 2)), rng.standard_normal((2, order)), d)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 12), st.integers(0, 1000), st.booleans())
def test_it_computes_its_recursion(order: int, seed: int, direct: bool) -> None:
    system = random_linear(order, seed, direct)
    u = np.random.default_rng(seed).standard_normal((30, 2))
    start = np.arange(order, dtype=float)
    model = state_space(order, {"u": "1", "v": "1"}, {"y": "1", "z": "1"}, direct)
    instance = Instance(model, matrices(system.a, system.b, system.c, system.d if direct else None, start))
    found = []
    for k, row in enumerate(u.tolist()):
        for name, value in zip("uv", row, strict=True):
            instance.set(name, value)
        found.append([instance.get("y"), instance.get("z")])
        instance.step(k * 0.01, 0.01)
    assert np.array(found) == pytest.approx(system.simulated(u, start), rel=1e-9, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), PACKAGINGS)
def test_the_fmu_of_an_identified_model_computes_its_recursion_with_nothing_set(
    tmp_path: Path, target: str, fmi: int
) -> None:
    system = random_linear(7, 3, direct=True)
    u = np.random.default_rng(1).standard_normal((40, 2))
    with opened(linear.build(system, tmp_path / "m.fmu", start=[1.0] * 7, target=target, fmi=fmi)) as fmu:
        fmu.start()
        found = []
        for k, row in enumerate(u.tolist()):
            for name, value in zip("uv", row, strict=True):
                fmu.set(name, value)
            found.append(fmu.get("y", "z"))
            fmu.step(k * 0.01, 0.01)
    assert np.array(found) == pytest.approx(system.simulated(u, np.ones(7)), rel=1e-12, abs=1e-12)


def test_outputs_change_at_the_sampling_instants_only_however_short_the_steps() -> None:
    values = matrices([[0.5]], [[1.0]], [[1.0]], start=[4.0]) | {"sample_time": 0.1}
    instance = Instance(state_space(1, {"u": "1"}, {"y": "1"}), values)
    found = [instance.get("y")]
    for k in range(12):
        instance.step(k * 0.025, 0.025)
        found.append(instance.get("y"))
    assert found == [4.0] * 4 + [2.0] * 4 + [1.0] * 4 + [0.5]


def test_without_a_d_no_input_acts_at_once_and_with_one_all_do() -> None:
    ports = {"u": "1", "v": "1"}, {"y": "1"}
    assert symbolic.feed_through(state_space(2, *ports)) == {"y": ()}
    assert symbolic.feed_through(state_space(2, *ports, True)) == {"y": ("u", "v")}


LOOP = """
title: A loop around a linear plant
components:
  plant: {fmu: plant.fmu}
  controller: {model: pd, parameters: {kp: 0.4, kd: 0, sample_time: 0.01, reference: 1}}
connections:
  - controller.voltage -> plant.u
  - plant.y -> controller.position
run: {stop: 0.5, step: 0.01}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), PACKAGINGS)
def test_a_controller_closes_its_loop_without_a_delay(tmp_path: Path, target: str, fmi: int) -> None:
    system = random_linear(4, 8)
    system = Linear(system.a, system.b[:, :1], system.c[:1], np.zeros((1, 1)), 0.01, ("u",), ("y",))
    linear.build(system, tmp_path / "plant.fmu", {"u": "V", "y": "V"}, target=target, fmi=fmi)
    (tmp_path / "loop.yaml").write_text(LOOP)
    [case] = run_scenario(tmp_path / "loop.yaml").cases
    assert case.result is not None
    x, expected = np.zeros(4), []
    for _ in range(51):
        y = float(system.c[0] @ x)
        expected.append(y)
        x = system.a @ x + system.b[:, 0] * 0.4 * (1 - y)
    assert case.result.trace["plant.y"] == pytest.approx(np.array(expected), rel=1e-9, abs=1e-12)


# Elements of the matrices, by their names


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), PACKAGINGS)
def test_an_element_can_be_set_and_written_back_by_its_name(tmp_path: Path, target: str, fmi: int) -> None:
    system = random_linear(3, 5)
    path = linear.build(system, tmp_path / "m.fmu", target=target, fmi=fmi)
    values: dict[str, float | str] = {"A[2,3]": 0.125, "C[1,1]": -2.0, "x_start[3]": 1.0}
    [written] = write_back.write_back(path, {**values}, tmp_path / "w.fmu", {"from": "a test"})
    rows = []
    for fmu, given_ in ((path, values), (written, {})):
        with FmuFile(fmu) as file:
            slave = Slave(file, "plant")
            slave.set(given_)
            slave.begin(0.0, None)
            slave.run()
            rows.append([slave.get(name) for name in ("A[2,3]", "A[3,2]", "C[1,1]", "y")])
            slave.close()
    assert rows[0] == rows[1]
    assert rows[0][:3] == [0.125, system.a[2, 1], -2.0]


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), PACKAGINGS)
def test_after_a_reset_the_elements_are_those_of_the_file_again(tmp_path: Path, target: str, fmi: int) -> None:
    system = random_linear(2, 5)
    with FmuFile(linear.build(system, tmp_path / "m.fmu", target=target, fmi=fmi)) as file:
        slave = Slave(file, "plant")
        slave.set({"A[1,2]": 7.0})
        slave.reset()
        slave.set({"A[2,2]": 3.0})
        slave.begin(0.0, None)
        slave.run()
        assert [slave.get(f"A[{i},{j}]") for i in (1, 2) for j in (1, 2)] == [*system.a[0], system.a[1, 0], 3.0]
        slave.close()


@pytest.mark.slow
@pytest.mark.parametrize(("target", "fmi"), PACKAGINGS)
@pytest.mark.parametrize("name", ["A", "A[3,1]", "A[0,1]", "A[1]", "A[1,2,1]", "E[1,1]"])
def test_an_element_that_is_not_there_is_refused(tmp_path: Path, target: str, fmi: int, name: str) -> None:
    path = linear.build(random_linear(2, 5), tmp_path / "m.fmu", target=target, fmi=fmi)
    with pytest.raises(FmuFileError, match=r"no such variable|is an array"):
        write_back.write_back(path, {name: 1.0}, tmp_path / "w.fmu", {})


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
def test_in_fmi_3_a_matrix_is_one_variable_with_dimensions(tmp_path: Path) -> None:
    system = random_linear(3, 5)
    with opened(linear.build(system, tmp_path / "m.fmu", target="native", fmi=3)) as fmu:
        assert [int(size.start) for size in fmu.variables["B"].dimensions] == [3, 2]
        assert "B[1,1]" not in fmu.variables
        fmu.start()
        whole = fmu.fmu.getFloat64([fmu.variables["B"].valueReference], 6)
    assert list(whole) == system.b.ravel().tolist()


@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
@pytest.mark.parametrize("size", [1000000000, 4])
def test_an_array_whose_size_is_not_that_of_its_start_values_is_left_out_and_named(tmp_path: Path, size: int) -> None:
    path = linear.build(random_linear(3, 5), tmp_path / "m.fmu", target="native", fmi=3)
    files = archive.read(path)
    files["modelDescription.xml"] = files["modelDescription.xml"].replace(
        b'start="3" />', f'start="{size}" />'.encode()
    )
    archive.write(path, files)
    with FmuFile(path) as file:
        assert not [name for name in file.interface.ports if name.startswith("A")]
        assert "y" in file.interface.ports
        assert file.interface.left_out["A"].startswith(f"an array of {size} x {size} elements")


@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
def test_in_fmi_3_a_wrong_number_of_values_is_refused(tmp_path: Path) -> None:
    from fmpy.fmi1 import FMICallException

    with opened(linear.build(random_linear(3, 5), tmp_path / "m.fmu", target="native", fmi=3)) as fmu:
        reference = fmu.variables["B"].valueReference
        for size in (1, 5, 7):
            with pytest.raises(FMICallException):
                fmu.fmu.setFloat64([reference], [0.0] * size)
        assert "5 values where there are 6" in fmu.log[1][2]


@pytest.mark.slow
def test_generated_code_multiplies_row_by_row(tmp_path: Path) -> None:
    if not compiler.available():
        pytest.skip("no C compiler here")
    with zipfile.ZipFile(linear.build(random_linear(12, 1), tmp_path / "m.fmu", target="native")) as zipped:
        code = zipped.read("sources/model.c").decode()
    update = code[code.index("void model_update(") : code.index("void model_update_partials(")]
    assert "v[vr_x_3] = dot(12, &v[vr_A + 24], w0) + dot(2, &v[vr_B + 4], w1);" in update
    assert len(update.splitlines()) < 60


@pytest.mark.parametrize(
    ("inputs", "outputs", "problem"),
    [
        (("u",), ("x_1",), "no model of order 2"),
        (("u",), ("u",), "one name"),
        (("1u",), ("y",), "no name"),
        (("u",), ("A",), "an array and something else"),
        ((), ("y",), "no model of order 2"),
    ],
)
def test_names_that_cannot_be_are_refused(
    tmp_path: Path, inputs: tuple[str, ...], outputs: tuple[str, ...], problem: str
) -> None:
    m, p = len(inputs), len(outputs)
    system = Linear(np.eye(2), np.ones((2, m)), np.ones((p, 2)), np.zeros((p, m)), 0.01, inputs, outputs)
    with pytest.raises(ModelError, match=problem):
        linear.build(system, tmp_path / "m.fmu")


def test_matrices_that_are_not_finite_or_do_not_fit_are_refused(tmp_path: Path) -> None:
    system = random_linear(2, 5)
    with pytest.raises(ModelError, match=r"state_space\.A\[1,2\]: nan is no Real value"):
        linear.build(Linear(np.array([[1, np.nan], [0, 1]]), system.b, system.c, system.d), tmp_path / "m.fmu")
    with pytest.raises(ModelError, match=r"state_space\.B\[1,3\]: no such variable"):
        linear.build(Linear(system.a, np.ones((2, 3)), system.c, system.d), tmp_path / "m.fmu")


def test_models_of_one_size_and_names_are_one_model_and_built_from_one_code() -> None:
    assert state_space(3, {"u": "V"}, {"y": "V"}) is state_space(3, {"u": "V"}, {"y": "V"})
    assert library.find("state_space").arrays == {"A": (2, 2), "B": (2, 1), "C": (1, 2), "x_start": (2,)}
