"""FMU files from outside: what they offer is read, and what was unpacked goes away."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.packaging import targets
from orchestrator.fmi.file import FmuDescription, FmuFile, read_description
from tests.support.simulation.changed import changed, refusal, with_xml, without_dependencies
from tests.support.tools import third_party

TIME = (
    '<ScalarVariable name="time" valueReference="9" causality="independent" variability="continuous">'
    '<Real unit="ms"/></ScalarVariable>'
)


def test_the_interface_is_what_the_file_declares(pendulum: Path) -> None:
    with FmuFile(pendulum) as fmu:
        interface = fmu.interface
        assert (interface.model_name, interface.fmi_version, interface.has_state) == ("pendulum", "2.0", True)
        assert [port.name for port in interface.of("input")] == ["torque"]
        assert [port.name for port in interface.of("output")] == ["angle", "speed", "acceleration", "energy"]
        mass = interface.ports["added_mass"]
        assert (mass.unit, mass.type, mass.causality, mass.minimum, mass.maximum) == (
            "kg",
            "Real",
            "parameter",
            0,
            None,
        )
        assert mass.settable
        assert mass.numeric
        assert not interface.ports["energy"].settable
        assert dict(interface.feed_through) == {
            "angle": frozenset(),
            "speed": frozenset(),
            "acceleration": {"torque"},
            "energy": frozenset(),
        }
        assert (fmu.folder / "resources").is_dir()


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('start="2.0"', 'start="2,0"', "k: start='2,0' is no Real; correct it"),
        ('start="3"', 'start="1.5"', "n: start='1.5' is no Integer; correct it"),
        ('start="true"', 'start="yes"', "on: start='yes' is no Boolean; correct it"),
        ('start="1" />', 'start="slow" />', "mode: start='slow' is no Enumeration; correct it"),
        ('start="0.0" />', 'start="" />', "b: start='' is no Real; correct it"),
        ('name="b"', 'name="k"', "two variables are called 'k'"),
        ('dependencies="1 3', 'dependencies="1 77', "something that it refers to is not there"),
        ('dependencies="1"', 'dependencies="0"', "it refers to is not there (variable 0 of ModelStructure)"),
        ('index="2"', 'index="-1"', "it refers to is not there (variable -1 of ModelStructure)"),
        ('start="1" />', 'start="7" />', "mode: start='7' is no Enumeration; correct it: there are slow (1), fast (2)"),
        ('start="3"', 'start="2147483648"', "n: start='2147483648' is no Integer"),
        ('start="2.0"', 'start="2.0" min="5" max="1"', "k: has no value between its bounds [5, 1]"),
        ('start="2.0"', 'start="2.0" min="NaN"', "k: has no value between its bounds [nan, inf)"),
        (
            '"2" causality="parameter"',
            '"2" causality="parametr"',
            "'parametr' is none of FMI; did you mean 'parameter'?",
        ),
        ('initial="exact"', 'initial="exactly"', "k: initial='exactly' is none of FMI; did you mean 'exact'?"),
        ('valueReference="3"', 'valueReference="2"', "b: has the value reference 2 of k, and they start from 2.0 and"),
        ('valueReference="6"', 'valueReference="4"', "of n, and they start from 3 and from 1; ask its supplier"),
        (
            '"1" causality="output"',
            '"0" causality="input"',
            "y: has the value reference 0 of u, and they are both inputs",
        ),
        ("</ModelVariables>", f"{TIME}</ModelVariables>", "time: counts in ms, where runs count seconds"),
    ],
)
def test_what_a_description_says_wrongly_is_named(
    every_type: Path, tmp_path: Path, old: str, new: str, problem: str
) -> None:
    assert problem in refusal(with_xml(every_type, tmp_path / "odd.fmu", (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "name", "why"),
    [
        ('start="2.0"', 'start="NaN"', "k", "starts from NaN, which is no finite number: give it one"),
        ('start="2.0"', 'start="INF"', "k", "starts from INF, which is no finite number: give it one"),
        (
            'start="2.0"',
            'start="2.0" min="3"',
            "k",
            "starts from 2, outside its bounds [3, inf): give it a value inside",
        ),
        (
            'start="3"',
            'start="3" min="4" max="9"',
            "n",
            "starts from 3, outside its bounds [4, 9]: give it a value inside",
        ),
        ('<Real start="2.0"', "<Real", "k", "has no start value, so that only the FMU knows it: give it one"),
        ('start="2.0"', 'start="2.0" nominal="0"', "k", "has the nominal value 0, which should be positive"),
        ("<Real />", '<Real nominal="-3" />', "y", "has the nominal value -3, which should be positive"),
        ('stopTime="10.0"', 'stopTime="-1"', "default experiment", "is from 0 s to -1 s: say when runs stop"),
        ('startTime="0.0"', 'startTime="20"', "default experiment", "is from 20 s to 10 s: say when runs stop"),
        ('stepSize="0.01"', 'stepSize="0"', "default experiment", "has the stepSize 0, which should be positive"),
        ('stepSize="0.01"', 'tolerance="-1"', "default experiment", "has the tolerance -1, which should be positive"),
    ],
)
def test_what_a_description_may_not_mean_is_told_and_the_fmu_opens(
    every_type: Path, tmp_path: Path, old: str, new: str, name: str, why: str
) -> None:
    sound = FmuDescription(every_type).interface.doubts
    doubtful = FmuDescription(with_xml(every_type, tmp_path / "odd.fmu", (old, new))).interface.doubts
    assert (sound, doubtful) == ({}, {name: why})


def test_aliases_of_one_start_value_and_unit_are_one_variable(every_type: Path, tmp_path: Path) -> None:
    alias = ('valueReference="3"', 'valueReference="2"'), ('start="0.0"', 'start="2"')
    with FmuFile(with_xml(every_type, tmp_path / "alias.fmu", *alias)) as fmu:
        ports = fmu.interface.ports
    assert ports["b"].reference == ports["k"].reference


def test_aliases_in_units_that_differ_are_refused(every_type: Path, tmp_path: Path) -> None:
    units = (
        "<TypeDefinitions>",
        '<UnitDefinitions><Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit>'
        '<Unit name="mN.m"><BaseUnit kg="1" m="2" s="-2" factor="1e-3"/></Unit></UnitDefinitions><TypeDefinitions>',
    )
    alias = ('valueReference="3"', 'valueReference="2"'), ('start="2.0"', 'start="2" unit="N.m"')
    path = with_xml(every_type, tmp_path / "alias.fmu", units, *alias, ('start="0.0"', 'start="2" unit="mN.m"'))
    assert "of k, and they are in N.m and in mN.m" in refusal(path)


def test_a_unit_that_means_two_things_is_refused_and_a_display_unit_left_to_its_name(
    every_type: Path, tmp_path: Path
) -> None:
    def with_units(*units: str) -> Path:
        definitions = f"<UnitDefinitions>{''.join(units)}</UnitDefinitions><TypeDefinitions>"
        return with_xml(every_type, tmp_path / "units.fmu", ("<TypeDefinitions>", definitions))

    speed = '<Unit name="{}"><BaseUnit s="-1" rad="{}"/><DisplayUnit name="rpm" factor="{}"/></Unit>'
    ports = FmuDescription(with_units(speed.format("rad/s", 1, 9.549), speed.format("Hz", 0, 60))).interface.ports
    assert set(ports["k"].definitions) == {"rad/s", "Hz"}
    assert not ports["k"].meaning("rpm").declared
    twice = refusal(with_units(speed.format("rad/s", 1, 9.549), speed.format("rad/s", 0, 60)))
    assert "unit rad/s: is defined twice, and differently" in twice


@pytest.mark.parametrize("said", ["", ' relativeQuantity="false"', ' relativeQuantity="true"'])
def test_offsets_of_units_do_not_count_in_differences_whether_or_not_the_unit_is_defined(
    every_type: Path, tmp_path: Path, said: str
) -> None:
    path = with_xml(every_type, tmp_path / "t.fmu", ('<Real start="2.0"', f'<Real start="2.0" unit="degC"{said}'))
    port = FmuDescription(path).interface.ports["k"]
    assert port.typed("k", "280 K") == pytest.approx(280 if "true" in said else 280 - 273.15)


def test_the_word_of_a_variable_counts_over_that_of_its_type(every_type: Path, tmp_path: Path) -> None:
    declared = '<TypeDefinitions><SimpleType name="T"><Real unit="degC" relativeQuantity="true"/></SimpleType>'
    of_type = ("<TypeDefinitions>", declared), ('<Real start="2.0"', '<Real start="2.0" declaredType="T"')
    other = ('<Real start="0.0"', '<Real start="0.0" declaredType="T" relativeQuantity="false"')
    ports = FmuDescription(with_xml(every_type, tmp_path / "t.fmu", *of_type, other)).interface.ports
    assert (ports["k"].relative, ports["b"].relative) == (True, False)


def test_parameters_and_inputs_can_be_set_whether_or_not_they_say_what_they_start_from(
    every_type: Path, tmp_path: Path
) -> None:
    path = with_xml(every_type, tmp_path / "none.fmu", ('<Real start="1.0"', "<Real"), ('<Real start="2.0"', "<Real"))
    ports = FmuDescription(path).interface.ports
    assert {name for name, port in ports.items() if port.settable} == {"u", "k", "b", "n", "on", "mode"}


def test_enumerations_keep_the_names_of_their_items(tmp_path: Path) -> None:
    path = targets.build("excitation", tmp_path / "excitation.fmu", target="python")
    with FmuFile(path) as fmu:
        shape = fmu.interface.ports["shape"]
        assert shape.type == "Enumeration"
        assert shape.items is not None
        assert dict(list(shape.items.items())[:2]) == {"sine": 1, "sine sweep": 2}
        assert dict(fmu.interface.feed_through) == {"signal": frozenset()}


@pytest.mark.parametrize(("flag", "expected"), [("true", True), ("1", True), ("false", False), ("0", False)])
def test_flags_are_read_as_xml_writes_them(pendulum: Path, tmp_path: Path, flag: str, expected: bool) -> None:
    path = with_xml(pendulum, tmp_path / "flag.fmu", ('canGetAndSetFMUstate="true"', f'canGetAndSetFMUstate="{flag}"'))
    with FmuFile(path) as fmu:
        assert fmu.interface.has_state is expected


def test_outputs_whose_dependencies_are_not_given_are_unknown(pendulum: Path, tmp_path: Path) -> None:
    with FmuFile(changed(pendulum, tmp_path / "bare.fmu", without_dependencies)) as fmu:
        assert set(fmu.interface.feed_through.values()) == {None}


def test_without_inputs_nothing_can_react_whatever_is_declared(tmp_path: Path) -> None:
    source = targets.build("excitation", tmp_path / "excitation.fmu", target="python")
    with FmuFile(changed(source, tmp_path / "bare.fmu", without_dependencies)) as fmu:
        assert dict(fmu.interface.feed_through) == {"signal": frozenset()}


def test_leaving_removes_the_folder_even_on_an_error(pendulum: Path) -> None:
    with pytest.raises(ZeroDivisionError), FmuFile(pendulum) as fmu:
        folder = fmu.folder
        assert folder.is_dir()
        raise ZeroDivisionError
    assert not folder.exists()
    fmu.close()


def test_a_description_can_be_read_without_a_binary_for_this_platform() -> None:
    assert read_description(third_party.coupled_clutches_for_windows()).modelName == "CoupledClutches"
