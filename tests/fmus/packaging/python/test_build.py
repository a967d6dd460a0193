"""Python FMUs as another tool sees them: valid, self-contained, equal to the model, and robust."""

from __future__ import annotations

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from lxml import etree

from fmus import library, units
from fmus.errors import ModelError
from fmus.modelling import symbolic
from fmus.modelling.model import Model, Table, Variable, input_, output, parameter
from fmus.packaging import defaults
from fmus.packaging.python import build as python
from tests.support.loaded import loaded
from tests.support.stepping import grid, stepped

Built = Callable[[str], Path]
NAMES = library.names()
PENDULUM = library.find("pendulum")
RICH: dict[str, dict[str, float]] = {
    "pendulum": {"angle_start": 1.0, "coulomb_friction_positive": 0.004, "stribeck_friction": 0.002},
    "dc_motor": {"inductance": 0.01, "current_limit": 0.8, "back_emf": 0.2},
    "energy_controller": {"amplitude": 1.2, "sample_time": 0.03},
    "excitation": {"shape": 2, "amplitude": 2.0, "begin": 0.1},
    "daq": {"noise": 0.1, "bits": 8, "range": 2.0, "filter_order": 2, "cutoff": 5.0, "sample_time": 0.02},
    "flexible_arm": {"bending_stiffness": 0.05, "hub_inertia": 0.05, "bristle_stiffness": 20.0, "backlash": 0.02},
    "flexible_link": {"torque_gain": 0.2, "bristle_stiffness": 0.5, "softening": 0.3, "drag": 1.0, "speed_start": 1.0},
    "servo_drive": {"direction": 2, "voltage_limit": 0.6},
    "pd": {"compensated_by": 2, "sample_time": 0.02},
    "relay_bound": {"bound": 0.6, "sample_time": 0.02},
    "state_space": {"A[1,1]": 0.9, "A[1,2]": 0.2, "A[2,1]": -0.3, "B[2,1]": 0.5, "C[1,1]": 1.5, "x_start[2]": -0.7},
}


def description(path: Path) -> ET.Element:
    with zipfile.ZipFile(path) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


def drive(t: float) -> float:
    return 0.5 + 0.3 * math.sin(5 * t)


@pytest.mark.parametrize("name", NAMES)
def test_fmpy_has_no_complaint(fmu: Built, name: str) -> None:
    assert validate_fmu(str(fmu(name))) == []


@pytest.mark.parametrize("name", NAMES)
def test_description_fits_the_schema_of_the_standard(fmu: Built, name: str) -> None:
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"))
    with zipfile.ZipFile(fmu(name)) as archive:
        schema.assertValid(etree.fromstring(archive.read("modelDescription.xml")))


@pytest.mark.parametrize("name", NAMES)
def test_description_carries_what_the_model_declares(fmu: Built, name: str) -> None:
    found = {v.name: v for v in fmpy.read_model_description(str(fmu(name))).modelVariables}
    model = library.find(name)
    assert list(found) == [variable.name for variable in model.variables]
    for variable in model.variables:
        assert_described(found[variable.name], variable)


def assert_described(found: Any, variable: Variable) -> None:
    assert found.causality == variable.causality
    assert found.description == variable.description
    assert found.type == ("Enumeration" if variable.choices else variable.type)
    if variable.type == "Real":
        assert found.unit == (None if variable.unit == "1" else variable.unit)
    for text, limit in ((found.min, variable.minimum), (found.max, variable.maximum), (found.start, variable.start)):
        assert (text is None) == (limit is None), variable.name
        if limit is not None:
            assert float(text) == limit, variable.name


@pytest.mark.parametrize("name", NAMES)
def test_units_are_defined_by_their_si_base_units(fmu: Built, name: str) -> None:
    defined = {unit.get("name"): unit.find("BaseUnit") for unit in description(fmu(name)).iter("Unit")}
    used = {variable.unit for variable in library.find(name).variables if variable.type == "Real"} - {"1"}
    assert set(defined) == used
    for unit_name in used:
        base, unit = defined[unit_name], units.parse(unit_name)
        assert base is not None
        assert unit is not None
        assert float(base.get("factor", "1")) == unit.factor
        assert tuple(int(base.get(unit_base, "0")) for unit_base in units.BASES) == unit.exponents


@pytest.mark.parametrize("name", NAMES)
def test_dependencies_of_the_outputs_are_the_feed_through(fmu: Built, name: str) -> None:
    model = library.find(name)
    direct = {}
    for unknown in description(fmu(name)).findall("ModelStructure/Outputs/Unknown"):
        places = [int(place) for place in (unknown.get("dependencies") or "").split()]
        key = model.variables[int(unknown.get("index", "0")) - 1].name
        direct[key] = tuple(model.variables[place - 1].name for place in places)
    assert direct == symbolic.feed_through(model)


def test_choices_are_an_enumeration_by_their_names(fmu: Built) -> None:
    items = [item.get("name") for item in description(fmu("excitation")).iter("Item")]
    assert items == list(library.find("excitation").by_name["shape"].choices)


@pytest.mark.parametrize("name", NAMES)
def test_defaults_in_the_resources_are_the_start_values_of_the_description(fmu: Built, name: str) -> None:
    with zipfile.ZipFile(fmu(name)) as archive:
        inside = defaults.load(archive.read(defaults.RESOURCE).decode())
    starts = {v.name: v.start for v in fmpy.read_model_description(str(fmu(name))).modelVariables if v.start}
    assert {key: float(value) for key, value in starts.items()} == inside


@pytest.mark.parametrize("name", NAMES)
def test_fmpy_simulates_what_an_instance_computes(fmu: Built, name: str) -> None:
    """Bit by bit, on the grid of the communication points, with every input driven."""
    model = library.find(name)
    outputs = [variable.name for variable in model.of("output")]
    inputs = [variable.name for variable in model.of("input")]
    time = grid(1.0, 0.0625)
    driven = np.array(
        [(t, *[drive(t)] * len(inputs)) for t in time], dtype=[("time", float), *((key, float) for key in inputs)]
    )
    result = fmpy.simulate_fmu(
        str(fmu(name)),
        stop_time=1.0,
        step_size=0.0625,
        output_interval=0.0625,
        start_values=RICH[name],
        input=driven if inputs else None,
        output=outputs,
        fmi_type="CoSimulation",
    )
    expected = stepped(model, RICH[name], outputs, time, dict.fromkeys(inputs, drive))
    found = np.column_stack([result[key] for key in outputs])
    assert np.array_equal(found[1:], expected[1:])


def test_values_given_to_build_act_with_nothing_set(tmp_path: Path) -> None:
    values = {"inertia": 0.00213, "angle_start": 0.7, "viscous_friction": 1.7e-4}
    path = python.build(PENDULUM, tmp_path / "calibrated.fmu", values)
    assert validate_fmu(str(path)) == []
    with loaded(path) as fmu:
        fmu.start()
        assert fmu.get(*values) == list(values.values())
        fmu.step(0.0, 0.5)
        assert fmu.get("angle", "speed") == stepped(PENDULUM, values, ("angle", "speed"), grid(0.5, 0.5))[-1].tolist()


def test_a_table_given_to_build_is_played_back(tmp_path: Path) -> None:
    table = Table("playback", list(np.array([0.0, 0.1, 1 / 3])), list(np.array([1.0, -2.0, 1e-17])))
    path = python.build(library.find("excitation"), tmp_path / "e.fmu", {"shape": 8}, {"playback": table})
    with loaded(path) as fmu:
        fmu.start()
        for k, time in enumerate(grid(0.5, 0.01)[:-1].tolist()):
            assert fmu.get("signal") == [pytest.approx(np.interp(time, table.time, table.values), rel=1e-12)], k
            fmu.step(time, 0.01)


def test_building_twice_gives_the_same_bytes_and_other_values_another_guid(tmp_path: Path) -> None:
    first, again = (python.build(PENDULUM, tmp_path / name) for name in ("a.fmu", "b.fmu"))
    assert first.read_bytes() == again.read_bytes()
    other = python.build(PENDULUM, tmp_path / "c.fmu", {"inertia": 0.004})
    assert description(other).get("guid") != description(first).get("guid")


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
    tmp_path: Path, values: dict[str, float], problem: str
) -> None:
    with pytest.raises(ModelError, match=problem):
        python.build(PENDULUM, tmp_path / "a.fmu", values)
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_the_wrong_type_and_unknown_tables_are_refused(tmp_path: Path) -> None:
    excitation = library.find("excitation")
    with pytest.raises(ModelError, match=r"excitation.seed: 1.5 is no Integer value"):
        python.build(excitation, tmp_path / "a.fmu", {"seed": 1.5})
    with pytest.raises(ModelError, match=r"excitation.shape: 10 is outside 1 to 9"):
        python.build(excitation, tmp_path / "a.fmu", {"shape": 10})
    with pytest.raises(ModelError, match=r"excitation.table: no such table; it has playback"):
        python.build(excitation, tmp_path / "a.fmu", tables={"table": Table("table")})


OWN = """from . import ops
from .model import Model, State, input_, output, parameter


def derivatives(t, x, u, p):
    return {"level": u.inflow * GAIN}


def outputs(t, x, u, p):
    return {"root": ops.sqrt(p.full - x.level), "state": 1.0 / p.divisor}


MODEL = Model(
    name="tank",
    description="Fills",
    variables=(
        input_("inflow", "1", "Input"), output("level", "1", "Output"), output("root", "1", "Fails when full"),
        output("state", "1", "Fails for a zero divisor"), parameter("full", "1", 100.0, "Level"),
        parameter("divisor", "1", 1.0, "Number"), parameter("pumps", "1", 2, "Number"), parameter("on", "1", True, ""),
    ),
    states=(State("level"),),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=lambda p: 1.0,
)
"""


def tank(folder: Path, gain: str = "1.0") -> Path:
    """The FMU of a user's own model, in a folder of its own."""
    folder.mkdir()
    (folder / "tank.py").write_text(OWN.replace("GAIN", gain))
    return python.build(library.find(str(folder / "tank.py")), folder / "tank.fmu")


def test_two_versions_of_one_model_live_in_one_process(tmp_path: Path) -> None:
    first, second = tank(tmp_path / "a", "1.0"), tank(tmp_path / "b", "3.0")
    with loaded(first) as one, loaded(second) as three:
        for fmu in (one, three):
            fmu.start(inflow=2.0)
            fmu.step(0.0, 1.0)
        assert (one.get("level"), three.get("level")) == ([2.0], [6.0])


def test_integers_and_booleans_are_carried(tmp_path: Path) -> None:
    path = tank(tmp_path / "a")
    assert validate_fmu(str(path)) == []
    with loaded(path) as fmu:
        pumps, on = fmu.references["pumps"], fmu.references["on"]
        assert (fmu.slave.getInteger([pumps]), fmu.slave.getBoolean([on])) == ([2], [True])
        fmu.slave.setInteger([pumps], [7])
        fmu.slave.setBoolean([on], [False])
        assert (fmu.slave.getInteger([pumps]), fmu.slave.getBoolean([on])) == ([7], [False])


def test_inputs_that_are_no_reals_are_discrete(tmp_path: Path) -> None:
    """FMI 2.0 knows no continuous integers or booleans."""
    folder = tmp_path / "a"
    folder.mkdir()
    text = OWN.replace('input_("inflow", "1", "Input")', 'input_("inflow", "1", "Input", start=True)')
    (folder / "tank.py").write_text(text.replace("u.inflow * GAIN", "ops.where(u.inflow > 0.5, 1.0, 0.0)"))
    assert validate_fmu(str(python.build(library.find(str(folder / "tank.py")), folder / "tank.fmu"))) == []


def test_reset_brings_the_defaults_and_the_start_back(fmu: Built) -> None:
    with loaded(fmu("pendulum")) as pendulum:
        runs = []
        for values in ({"angle_start": 1.0, "inertia": 0.01}, {}, {"angle_start": 1.0, "inertia": 0.01}, {}):
            pendulum.start(**values)
            pendulum.set("torque", 0.01)
            pendulum.step(0.0, 0.3)
            runs.append(pendulum.get("angle", "speed", "inertia"))
            pendulum.slave.reset()
        assert pendulum.get("angle", "inertia", "torque") == [0.0, 0.00325, 0.0]
    assert runs[0] == runs[2]
    assert runs[1] == runs[3]
    assert runs[0][2] == 0.01
    assert runs[1][2] == 0.00325


def advance(fmu: Any, first: int, last: int) -> list[float]:
    for k in range(first, last):
        fmu.set("signal", drive(k * 0.01))
        fmu.step(k * 0.01, 0.01)
    values: list[float] = fmu.get("measured", "signal")
    return values


def test_a_saved_state_continues_as_if_nothing_had_come_between(fmu: Built) -> None:
    with loaded(fmu("daq")) as daq:
        daq.start(**RICH["daq"])
        at_save = advance(daq, 0, 10)
        state = daq.slave.getFMUstate()
        expected = advance(daq, 10, 25)
        daq.slave.setFMUstate(state)
        assert daq.get("measured", "signal") == at_save
        assert advance(daq, 10, 25) == expected
        daq.slave.freeFMUstate(state)


def test_a_serialised_state_continues_in_another_instance(fmu: Built) -> None:
    with loaded(fmu("daq")) as one, loaded(fmu("daq")) as other:
        one.start(**RICH["daq"])
        advance(one, 0, 10)
        data = one.slave.serializeFMUstate(one.slave.getFMUstate())
        other.start()
        other.slave.setFMUstate(other.slave.deSerializeFMUstate(data))
        assert advance(other, 10, 25) == advance(one, 10, 25)


def assert_step_fails(fmu: Any, reason: str) -> None:
    """The step is refused with the reason in the log, as often as it is tried, and the FMU stays usable."""
    for _ in range(2):
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.1)
    assert any(reason in message for message in fmu.log), fmu.log


def test_a_requirement_that_does_not_hold_fails_the_step_with_its_reason(fmu: Built) -> None:
    with loaded(fmu("energy_controller")) as controller:
        controller.start()
        assert_step_fails(controller, "start energy is that of the downward equilibrium")
        controller.slave.reset()
        controller.start(angle=0.5)
        controller.step(0.0, 0.1)


def test_a_model_that_divides_by_zero_fails_the_step_with_the_reason(fmu: Built) -> None:
    with loaded(fmu("pendulum")) as pendulum:
        pendulum.start(inertia=0.0)
        assert_step_fails(pendulum, "ZeroDivisionError")
        pendulum.slave.reset()
        pendulum.start()
        pendulum.step(0.0, 0.1)


def test_an_output_that_cannot_be_computed_is_nan_and_the_next_step_fails(tmp_path: Path) -> None:
    with loaded(tank(tmp_path / "a")) as fmu:
        fmu.start(divisor=0.0)
        assert math.isnan(fmu.get("state")[0])
        assert_step_fails(fmu, "tank: ZeroDivisionError")
        fmu.slave.reset()
        fmu.start(inflow=200.0)
        fmu.step(0.0, 1.0)
        assert math.isnan(fmu.get("root")[0])
        assert any("ValueError" in message for message in fmu.log)


def test_setting_an_output_or_an_unknown_reference_fails_the_next_step(fmu: Built) -> None:
    for reference, reason in ((0, "has no input or parameter"), (9999, "IndexError")):
        with loaded(fmu("excitation")) as source:
            source.start()
            source.slave.setReal([reference], [1.0])
            assert_step_fails(source, reason)


def test_a_broken_default_stops_the_instantiation(fmu: Built, tmp_path: Path) -> None:
    path = tmp_path / "broken.fmu"
    with zipfile.ZipFile(fmu("pendulum")) as good, zipfile.ZipFile(path, "w") as bad:
        for name in good.namelist():
            bad.writestr(name, b"inertia = heavy\n" if name == defaults.RESOURCE else good.read(name))
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), loaded(path):
        pass


def test_a_model_that_cannot_be_traced_is_not_built(tmp_path: Path) -> None:
    model = replace(PENDULUM, derivatives=lambda t, x, u, p: {"angle": x.speed, "speed": math.sin(x.angle)})
    with pytest.raises(ModelError, match="cannot be traced"):
        python.build(model, tmp_path / "a.fmu")
    assert list(tmp_path.iterdir()) == []


def test_a_model_without_functions_is_not_built(tmp_path: Path) -> None:
    empty = Model("empty", "Nothing", (input_("a", "1", ""), output("b", "1", ""), parameter("c", "1", 1.0, "")))
    with pytest.raises(ModelError, match="has no functions"):
        python.build(empty, tmp_path / "a.fmu")


MANY = """
import sys
from pathlib import Path
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

path = {path!r}
description, folder = read_model_description(path), extract(path)
alive = []
for k in range(50):
    slave = FMU2Slave(guid=description.guid, unzipDirectory=folder, instanceName=f"i{{k}}",
                      modelIdentifier=description.coSimulation.modelIdentifier)
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.doStep(0.0, 0.01)
    slave.reset()
    alive.append(slave)
    if k % 3 == 0:
        alive.pop(0).freeInstance()
(shim,) = (m for n, m in sys.modules.items() if n.startswith("pendulum_") and n.endswith("_slave") and "." not in n)
print(sys.getrefcount(shim.__dict__) > 1, shim.Slave.model.name)
for slave in alive:
    slave.freeInstance()
print("freed")
"""


def test_fifty_instances_are_created_and_freed_without_losing_their_module(fmu: Built) -> None:
    """pythonfmu 0.7 drops one reference to the module's namespace with every instance it creates."""
    program = MANY.format(path=str(fmu("pendulum")))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["True", "pendulum", "freed"]), done.stderr


def test_an_fmu_runs_where_the_project_is_not_installed(fmu: Built, tmp_path: Path) -> None:
    program = (
        "import sys, fmpy\n"
        f"result = fmpy.simulate_fmu({str(fmu('pendulum'))!r}, stop_time=0.1, start_values={{'angle_start': 1.0}})\n"
        "assert not any(name == 'fmus' or name.startswith('fmus.') for name in sys.modules)\n"
        "print(result['angle'][0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=tmp_path,
        env={"PATH": ""},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout.split()) == (0, ["1.0"]), done.stderr
