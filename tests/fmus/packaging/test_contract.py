"""What an FMU of any packaging does, as another tool sees it: valid, equal to the model, and repeatable."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from lxml import etree

from fmus import library
from fmus.errors import ModelError
from fmus.modelling.model import Table, Variable, element, element_names, start_values
from fmus.packaging import archive, defaults
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from fmus.packaging.python import build as python
from tests.support.fmus.either import opened, schema
from tests.support.fmus.natives import NAMES, PENDULUM, RICH, advance, drive, in_arrays
from tests.support.fmus.stepping import grid, stepped

FMI3_TYPES = {"Real": "Float64", "Integer": "Int32"}
VALUES = {"inertia": 0.00213, "angle_start": 0.7, "viscous_friction": 1.7e-4}


def described(path: Path) -> list[Any]:
    variables: list[Any] = fmpy.read_model_description(str(path)).modelVariables
    return variables


def identity(path: Path) -> str | None:
    root = ET.fromstring(archive.read(path)["modelDescription.xml"])
    return root.get("guid") or root.get("instantiationToken")


class Contract:
    """The claims; a packaging says which version of FMI it writes, and how."""

    fmi: int

    @staticmethod
    def build(*order: Any) -> Path:
        raise NotImplementedError

    @pytest.fixture
    def library_fmu(self, fmu: Callable[[str], Path]) -> Callable[[str], Path]:
        """name -> the FMU of that model of the library, with its own defaults."""
        return fmu

    @pytest.mark.parametrize("name", NAMES)
    def test_it_is_valid(self, library_fmu: Callable[[str], Path], name: str) -> None:
        assert validate_fmu(str(library_fmu(name))) == []
        document = etree.fromstring(archive.read(library_fmu(name))["modelDescription.xml"])
        etree.XMLSchema(file=str(schema(self.fmi))).assertValid(document)

    @pytest.mark.parametrize("name", NAMES)
    def test_its_description_carries_what_the_model_declares(
        self, library_fmu: Callable[[str], Path], name: str
    ) -> None:
        found = {variable.name: variable for variable in described(library_fmu(name))}
        model = library.find(name)
        scalars = [v for v in model.variables if self.fmi == 2 or element(v.name) is None]
        declared = {variable.name for variable in scalars}
        assert [key for key in found if key in declared] == [variable.name for variable in scalars]
        for variable in scalars:
            self.assert_described(found[variable.name], variable)
        for name_, shape in model.arrays.items() if self.fmi == 3 else ():
            starts = [start_values(model)[part] for part in element_names(name_, shape)]
            assert [int(size.start) for size in found[name_].dimensions] == list(shape)
            assert [float(start) for start in found[name_].start.split()] == starts

    def assert_described(self, found: Any, variable: Variable) -> None:
        kind = "Enumeration" if variable.choices else variable.type
        assert found.type == (kind if self.fmi == 2 else FMI3_TYPES.get(kind, kind))
        assert (found.causality, found.description) == (variable.causality, variable.description)
        if variable.type == "Real":
            assert found.unit == (None if variable.unit == "1" else variable.unit)
        limits = ((found.min, variable.minimum), (found.max, variable.maximum), (found.start, variable.start))
        for text, limit in limits:
            assert (text is None) == (limit is None), variable.name
            if limit is not None:
                assert float(text) == limit, variable.name

    @pytest.mark.parametrize("name", NAMES)
    def test_defaults_in_its_resources_are_the_start_values_of_its_description(
        self, library_fmu: Callable[[str], Path], name: str
    ) -> None:
        inside = defaults.load(archive.read(library_fmu(name))[defaults.RESOURCE].decode())
        starts: dict[str, float] = {}
        for v in described(library_fmu(name)):
            names = element_names(v.name, [int(size.start) for size in v.dimensions]) if v.dimensions else [v.name]
            starts |= dict(zip(names, map(float, v.start.split()), strict=True)) if v.start else {}
        assert starts == inside

    @pytest.mark.parametrize("name", NAMES)
    def test_it_computes_what_an_instance_computes(self, library_fmu: Callable[[str], Path], name: str) -> None:
        """Bit by bit, on the grid of the communication points, with every input driven."""
        model = library.find(name)
        outputs, inputs = ([variable.name for variable in model.of(kind)] for kind in ("output", "input"))
        time = grid(1.0, 0.0625)
        columns = [("time", float), *((key, float) for key in inputs)]
        driven = np.array([(t, *[drive(t)] * len(inputs)) for t in time], dtype=columns)
        result = fmpy.simulate_fmu(
            str(library_fmu(name)),
            stop_time=1.0,
            step_size=0.0625,
            output_interval=0.0625,
            start_values=in_arrays(model, RICH[name]) if self.fmi == 3 else RICH[name],
            input=driven if inputs else None,
            output=outputs,
            fmi_type="CoSimulation",
        )
        expected = stepped(model, RICH[name], outputs, time, dict.fromkeys(inputs, drive))
        assert np.array_equal(np.column_stack([result[key] for key in outputs])[1:], expected[1:])

    def test_values_given_to_build_act_with_nothing_set(self, tmp_path: Path) -> None:
        path = self.build(PENDULUM, tmp_path / "calibrated.fmu", VALUES)
        assert validate_fmu(str(path)) == []
        with opened(path) as fmu:
            fmu.start()
            assert fmu.get(*VALUES) == list(VALUES.values())
            fmu.step(0.0, 0.5)
            end = stepped(PENDULUM, VALUES, ("angle", "speed"), grid(0.5, 0.5))[-1]
            assert fmu.get("angle", "speed") == end.tolist()

    def test_a_table_given_to_build_is_played_back(self, tmp_path: Path) -> None:
        table = Table("playback", list(np.array([0.0, 0.1, 1 / 3])), list(np.array([1.0, -2.0, 1e-17])))
        path = self.build(library.find("excitation"), tmp_path / "e.fmu", {"shape": 8}, {"playback": table})
        with opened(path) as fmu:
            fmu.start()
            for k, time in enumerate(grid(0.5, 0.01)[:-1].tolist()):
                assert fmu.get("signal") == [pytest.approx(np.interp(time, table.time, table.values), rel=1e-12)], k
                fmu.step(time, 0.01)

    def test_building_twice_gives_the_same_bytes_and_other_values_another_identity(self, tmp_path: Path) -> None:
        first, again = (self.build(PENDULUM, tmp_path / name) for name in ("a.fmu", "b.fmu"))
        assert first.read_bytes() == again.read_bytes()
        assert identity(self.build(PENDULUM, tmp_path / "c.fmu", {"inertia": 0.004})) != identity(first)

    @pytest.mark.parametrize(
        ("values", "problem"),
        [
            ({"inertiaa": 1.0}, "pendulum.inertiaa: no such variable"),
            ({"angle": 1.0}, "pendulum.angle: no such variable"),
            ({"inertia": -1.0}, "pendulum.inertia: -1.0 is outside 0 to inf"),
            ({"inertia": math.nan}, "pendulum.inertia: nan is no Real value"),
            ({"inertia": math.inf}, "pendulum.inertia: inf is no Real value"),
        ],
    )
    def test_values_a_model_cannot_have_are_refused_and_nothing_is_written(
        self, tmp_path: Path, values: dict[str, float], problem: str
    ) -> None:
        with pytest.raises(ModelError, match=problem):
            self.build(PENDULUM, tmp_path / "a.fmu", values)
        assert list(tmp_path.iterdir()) == []

    def test_reset_brings_the_defaults_and_the_start_back(self, library_fmu: Callable[[str], Path]) -> None:
        with opened(library_fmu("pendulum")) as fmu:
            runs = []
            for values in ({"angle_start": 1.0, "inertia": 0.01}, {}, {"angle_start": 1.0, "inertia": 0.01}, {}):
                fmu.start(**values)
                fmu.set("torque", 0.01)
                fmu.step(0.0, 0.3)
                runs.append(fmu.get("angle", "speed", "inertia"))
                fmu.fmu.reset()
            assert fmu.get("angle", "inertia", "torque") == [0.0, 0.00325, 0.0]
        assert runs[0] == runs[2] != runs[1] == runs[3]
        assert (runs[0][2], runs[1][2]) == (0.01, 0.00325)

    def test_a_saved_state_continues_as_if_nothing_had_come_between(self, library_fmu: Callable[[str], Path]) -> None:
        with opened(library_fmu("daq")) as daq:
            daq.start(**RICH["daq"])
            at_save = advance(daq, 0, 10)
            state = daq.save()
            expected = advance(daq, 10, 25)
            daq.restore(state)
            assert daq.get("measured", "signal") == at_save
            assert advance(daq, 10, 25) == expected
            daq.drop(state)

    def test_a_serialised_state_continues_in_another_instance(self, library_fmu: Callable[[str], Path]) -> None:
        with opened(library_fmu("daq")) as one, opened(library_fmu("daq")) as other:
            one.start(**RICH["daq"])
            advance(one, 0, 10)
            data = one.serialize(one.save())
            assert data == one.serialize(one.save())
            other.start()
            other.restore(other.deserialize(data))
            assert advance(other, 10, 25) == advance(one, 10, 25)

    def test_a_requirement_that_does_not_hold_fails_the_step_with_its_reason(
        self, library_fmu: Callable[[str], Path]
    ) -> None:
        with opened(library_fmu("energy_controller"), logging=True) as controller:
            controller.start()
            for _ in range(2):
                with pytest.raises(FMICallException):
                    controller.step(0.0, 0.1)
            assert any("start energy is that of the downward equilibrium" in text for _, _, text in controller.log)
            controller.fmu.reset()
            controller.start(angle=0.5)
            controller.step(0.0, 0.1)


class TestPython(Contract):
    fmi = 2
    build = staticmethod(python.build)


class Native(Contract):
    pytestmark = [
        pytest.mark.slow,  # compilers
        pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
    ]

    @pytest.fixture
    def library_fmu(self, native_fmu: Callable[[str, int], Path]) -> Callable[[str], Path]:
        return lambda name: native_fmu(name, self.fmi)


class TestNative2(Native):
    fmi = 2
    build = staticmethod(native.build)


class TestNative3(Native):
    fmi = 3

    @staticmethod
    def build(model: Any, path: Path, parameters: Any = None, tables: Any = None) -> Path:
        return native.build(model, path, parameters, tables, fmi=3)
