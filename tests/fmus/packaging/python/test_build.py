"""Python FMUs as another tool sees them: valid, self-contained, equal to the model, and robust."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from fmus import library, units
from fmus.errors import ModelError
from fmus.modelling import symbolic
from fmus.modelling.model import Model, Table, input_, output, parameter
from fmus.packaging import defaults
from fmus.packaging.python import build as python
from tests.support.fmus.either import opened
from tests.support.memory_errors import memory_errors, needs_valgrind

Built = Callable[[str], Path]
NAMES = library.names()
PENDULUM = library.find("pendulum")


def description(path: Path) -> ET.Element:
    with zipfile.ZipFile(path) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


@pytest.mark.slow
def test_an_fmu_that_ran_and_is_gone_does_not_lend_its_pythonfmu(fmu: Built, tmp_path: Path) -> None:
    code = (
        "import sys\nfrom pathlib import Path\nfrom fractions import Fraction\n"
        "from fmus import build\nfrom orchestrator import open_system\n"
        "with open_system({'rig': sys.argv[1]}) as system:\n    system.run(0.1, 0.1)\n"
        "build('pendulum', sys.argv[2], target='python')\n"
    )
    target = tmp_path / "pendulum.fmu"
    subprocess.run(
        [sys.executable, "-c", code, str(fmu("excitation")), str(target)],
        check=True,
        env={**os.environ, "SERVOTWIN_CACHE": "off"},
    )
    assert target.is_file()


@pytest.mark.slow
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


def test_numbers_of_the_wrong_type_and_unknown_tables_are_refused(tmp_path: Path) -> None:
    excitation = library.find("excitation")
    with pytest.raises(ModelError, match=r"excitation.seed: 1.5 is no Integer value"):
        python.build(excitation, tmp_path / "a.fmu", {"seed": 1.5})
    with pytest.raises(ModelError, match=r"excitation.shape: 11 is outside 1 to 10"):
        python.build(excitation, tmp_path / "a.fmu", {"shape": 11})
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
    with opened(first) as one, opened(second) as three:
        for fmu in (one, three):
            fmu.start(inflow=2.0)
            fmu.step(0.0, 1.0)
        assert (one.get("level"), three.get("level")) == ([2.0], [6.0])


def test_integers_and_booleans_are_carried(tmp_path: Path) -> None:
    path = tank(tmp_path / "a")
    assert validate_fmu(str(path)) == []
    with opened(path) as fmu:
        assert fmu.get("pumps", "on") == [2, True]
        fmu.set("pumps", 7)
        fmu.set("on", False)
        assert fmu.get("pumps", "on") == [7, False]


def test_inputs_that_are_no_reals_are_discrete(tmp_path: Path) -> None:
    """FMI 2.0 knows no continuous integers or booleans."""
    folder = tmp_path / "a"
    folder.mkdir()
    text = OWN.replace('input_("inflow", "1", "Input")', 'input_("inflow", "1", "Input", start=True)')
    (folder / "tank.py").write_text(text.replace("u.inflow * GAIN", "ops.where(u.inflow > 0.5, 1.0, 0.0)"))
    assert validate_fmu(str(python.build(library.find(str(folder / "tank.py")), folder / "tank.fmu"))) == []


def assert_step_fails(fmu: Any, reason: str) -> None:
    """The step is refused with the reason in the log, as often as it is tried, and the FMU stays usable."""
    for _ in range(2):
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.1)
    assert any(reason in message for _, _, message in fmu.log), fmu.log


def test_a_model_that_divides_by_zero_fails_the_step_with_the_reason(fmu: Built) -> None:
    with opened(fmu("pendulum"), logging=True) as pendulum:
        pendulum.start(inertia=0.0)
        assert_step_fails(pendulum, "ZeroDivisionError")
        pendulum.fmu.reset()
        pendulum.start()
        pendulum.step(0.0, 0.1)


def test_an_output_that_cannot_be_computed_is_nan_and_the_next_step_fails(tmp_path: Path) -> None:
    with opened(tank(tmp_path / "a"), logging=True) as fmu:
        fmu.start(divisor=0.0)
        assert math.isnan(fmu.get("state")[0])
        assert_step_fails(fmu, "tank: ZeroDivisionError")
        fmu.fmu.reset()
        fmu.start(inflow=200.0)
        fmu.step(0.0, 1.0)
        assert math.isnan(fmu.get("root")[0])
        assert any("ValueError" in message for _, _, message in fmu.log)


def test_setting_an_output_or_an_unknown_reference_fails_the_next_step(fmu: Built) -> None:
    for reference, reason in ((0, "has no input or parameter"), (9999, "IndexError")):
        with opened(fmu("excitation"), logging=True) as source:
            source.start()
            source.fmu.setReal([reference], [1.0])
            assert_step_fails(source, reason)


def test_a_broken_default_stops_the_instantiation(fmu: Built, tmp_path: Path) -> None:
    path = tmp_path / "broken.fmu"
    with zipfile.ZipFile(fmu("pendulum")) as good, zipfile.ZipFile(path, "w") as bad:
        for name in good.namelist():
            bad.writestr(name, b"inertia = heavy\n" if name == defaults.RESOURCE else good.read(name))
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(path):
        pass


def test_a_model_that_cannot_be_traced_is_not_built(tmp_path: Path) -> None:
    model = replace(PENDULUM, derivatives=lambda t, x, u, p: {"angle": x.speed, "speed": math.sin(x.angle)})
    with pytest.raises(ModelError, match=r"write ops\.sin"):
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


@pytest.mark.slow
@needs_valgrind
def test_a_process_that_had_the_fmu_ends_without_touching_freed_memory(fmu: Built, tmp_path: Path) -> None:
    """pythonfmu 0.7 writes there at the end of a process unless it has let go of Python before: some abort."""
    program = MANY.format(path=str(fmu("pendulum"))).replace("range(50)", "range(4)")
    assert "finalizePythonInterpreter" not in memory_errors(program, tmp_path)


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
