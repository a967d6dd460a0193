"""Ports of models as terminals of their FMUs, and the icons of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from fmus import library, units
from fmus.errors import ModelError
from fmus.modelling.model import Model, input_, output
from fmus.modelling.ports import KINDS, port
from fmus.packaging import archive, targets
from fmus.packaging.description.terminals import FMI2
from tests.support.fmus.either import schema
from tests.support.fmus.natives import NAMES

XML = "terminalsAndIcons/terminalsAndIcons.xml"
WITH_PORTS = [name for name in NAMES if library.find(name).ports]
Built = Callable[[str, int], Path]
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_terminals_and_icons_are_valid_and_there(source_fmu: Built, name: str) -> None:
    files = archive.read(source_fmu(name, 3))
    document = etree.fromstring(files[XML])
    etree.XMLSchema(etree.parse(schema(3).with_name("fmi3TerminalsAndIcons.xsd"))).assertValid(document)
    described = fmpy.read_model_description(str(source_fmu(name, 3)))
    causes = {variable.name: variable.causality for variable in described.modelVariables}
    for terminal in document.iterfind("Terminals/Terminal"):
        members = terminal.findall("TerminalMemberVariable")
        assert sorted(causes[member.get("variableName")] for member in members) == ["input", "output"]
    drawn = {entry.get("iconBaseName") for entry in document.iter("TerminalGraphicalRepresentation")}
    for picture in {"icon", *drawn}:
        etree.fromstring(files[f"terminalsAndIcons/{picture}.svg"])
        assert files[f"terminalsAndIcons/{picture}.png"].startswith(PNG)
    assert (document.find("Terminals") is not None) == bool(library.find(name).ports)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_fmi_2_has_an_icon_and_keeps_the_terminals_among_what_is_of_tools(source_fmu: Built, name: str) -> None:
    files, modern = archive.read(source_fmu(name, 2)), archive.read(source_fmu(name, 3))
    assert files["model.png"] == modern["terminalsAndIcons/icon.png"]
    assert (FMI2 in files) == bool(library.find(name).ports)
    assert not any(entry.startswith("terminalsAndIcons") for entry in files)
    if FMI2 in files:
        own = [entry.get("name") for entry in etree.fromstring(files[FMI2]).iter("Terminal")]
        assert own == [entry.get("name") for entry in etree.fromstring(modern[XML]).iter("Terminal")]


@pytest.mark.parametrize("name", WITH_PORTS)
def test_what_goes_through_a_port_is_a_power(name: str) -> None:
    model, watt = library.find(name), units.parse("W")
    assert watt is not None
    for one in model.ports:
        signal, flow = (units.parse(model.by_name[variable].unit) for variable in (one.signal, one.flow))
        assert signal is not None and flow is not None
        assert signal.times(flow).fits(watt)
        assert one.outward == (one.kind != "electrical" and model.by_name[one.flow].causality == "output")


def gauge(unit: str = "N.m") -> Model:
    return Model(
        name="gauge",
        description="A shaft whose torque is its speed",
        variables=(input_("w", "rad/s", "Speed"), output("m", unit, "Torque")),
        outputs=lambda t, x, u, p: {"m": u.w},
        ports=(port("end", "rotational", speed="w", torque="m"),),
    )


@pytest.mark.slow
def test_a_port_of_another_quantity_names_it(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gauge: port end: m is its torque and has the unit 'V'; give it one of N\.m"):
        targets.build(gauge("V"), tmp_path / "gauge.fmu", target="native")
    assert validate_fmu(str(targets.build(gauge(), tmp_path / "gauge.fmu", target="native", fmi=3))) == []


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: port("a", "rotational", speed="w"), "is rotational and gives speed; it needs speed and torque"),
        (lambda: port("a", "thermal", heat="w"), f"it needs one of the kinds {', '.join(KINDS)}"),
        (lambda: replace(gauge(), ports=(port("a", "rotational", speed="w", torque="x"),)), "needs an input and an"),
        (lambda: replace(gauge(), ports=(port("w", "rotational", speed="w", torque="m"),)), "a name of its own"),
        (lambda: replace(gauge(), ports=gauge().ports * 2), "a name of its own"),
    ],
)
def test_a_port_that_does_not_fit_its_model_is_refused(make: Callable[[], object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        make()
