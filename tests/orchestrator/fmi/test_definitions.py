"""What an FMU says of its units, in either version of FMI, and what it must not say."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from fmus.errors import FmuFileError
from fmus.packaging import archive
from fmus.units import Unit
from orchestrator.fmi import definitions
from orchestrator.fmi.file import read_description

UNITS = """<UnitDefinitions>
<Unit name="degC"><BaseUnit K="1" offset="273.15"/><DisplayUnit name="Fahr" factor="1.8" offset="32"/></Unit>
<Unit name="1/min"><BaseUnit s="-1" rad="1" factor="0.5"/><DisplayUnit name="degC" factor="3"/></Unit>
<Unit name="s"><BaseUnit s="1"/>{inverse}</Unit>
<Unit name="bare"/>
</UnitDefinitions>"""
FMI2 = """<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g"><CoSimulation modelIdentifier="m"/>{units}
<ModelVariables><ScalarVariable name="x" valueReference="0" causality="output"><Real unit="s"/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>"""
FMI3 = """<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="g"><CoSimulation modelIdentifier="m"/>
{units}<ModelVariables><Float64 name="x" valueReference="0" causality="output" unit="s"/></ModelVariables>
<ModelStructure/></fmiModelDescription>"""


def units(folder: Path, template: str, definition: str) -> dict[str, Unit]:
    path = folder / "m.fmu"
    archive.write(path, {"modelDescription.xml": template.format(units=definition).encode()})
    return definitions.units(path, read_description(path))


@pytest.mark.parametrize(("template", "inverse"), [(FMI2, ""), (FMI3, '<DisplayUnit name="Hz" inverse="true"/>')])
def test_factor_offset_and_exponents_are_what_the_fmu_defines(tmp_path: Path, template: str, inverse: str) -> None:
    found = units(tmp_path, template, UNITS.format(inverse=inverse))
    assert set(found) == {"degC", "1/min", "s", "Fahr"}  # a display unit does not stand over a unit
    assert found["degC"] == Unit(1.0, (0, 0, 0, 0, 1, 0, 0, 0), 273.15)
    assert found["1/min"] == Unit(0.5, (0, 0, -1, 0, 0, 0, 0, 1))
    kelvin = found["Fahr"].factor * 212.0 + found["Fahr"].offset
    assert math.isclose(kelvin, 373.15)


@pytest.mark.parametrize("wrong", ['factor="0"', 'factor="nan"', 'offset="inf"', 'factor="1e999"'])
def test_a_definition_that_converts_nothing_is_refused(tmp_path: Path, wrong: str) -> None:
    with pytest.raises(FmuFileError, match=r"m\.fmu: unit u: has a factor or offset that converts nothing"):
        units(tmp_path, FMI2, f'<UnitDefinitions><Unit name="u"><BaseUnit s="1" {wrong}/></Unit></UnitDefinitions>')
