"""FMU files from outside: what they offer is read, what is wrong with them is one line, what was unpacked goes away."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, FmuFileError, InputError
from fmus.packaging import archive, targets
from orchestrator.fmi.file import FmuDescription, FmuFile, read_description
from orchestrator.fmi.slave import Slave
from tests.support.simulation.ssps import gain
from tests.support.tools import third_party

pytestmark = pytest.mark.usefixtures("scratch")

XML = "modelDescription.xml"
TIME = (
    '<ScalarVariable name="time" valueReference="9" causality="independent" variability="continuous">'
    '<Real unit="ms"/></ScalarVariable>'
)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return targets.build("pendulum", tmp_path_factory.mktemp("fmu") / "pendulum.fmu", target="python")


@pytest.fixture(scope="module")
def every_type() -> Path:
    """An FMU with parameters of all types."""
    return gain()


def changed(source: Path, target: Path, change: Callable[[dict[str, bytes]], Mapping[str, bytes]]) -> Path:
    archive.write(target, change(archive.read(source)))
    return target


def without_dependencies(files: dict[str, bytes]) -> dict[str, bytes]:
    return {**files, XML: re.sub(rb' dependencies="[^"]*"', b"", files[XML])}


def with_xml(source: Path, target: Path, *replacements: tuple[str, str]) -> Path:
    def change(files: dict[str, bytes]) -> dict[str, bytes]:
        text = files[XML].decode()
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        return {**files, XML: text.encode()}

    return changed(source, target, change)


def refusal(path: Path) -> str:
    """The message with which a file is refused, seen to be one line that names the file."""
    with pytest.raises(FmuFileError) as refused:
        FmuFile(path)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message.removeprefix(str(path))


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


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is not a zip archive"),
        (b"no zip at all", "is not a zip archive"),
        (b"PK\x03\x04" + b"\0" * 100, "is not a zip archive"),
    ],
)
def test_what_is_no_zip_is_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "no.fmu"
    path.write_bytes(content)
    assert problem in refusal(path)


@pytest.mark.parametrize("keep", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(pendulum: Path, tmp_path: Path, keep: float) -> None:
    content = pendulum.read_bytes()
    path = tmp_path / "cut.fmu"
    path.write_bytes(content[: int(keep * len(content))])
    assert "is not a zip archive" in refusal(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "missing.fmu") == ": no such file; check the path"
    assert refusal(tmp_path) == ": is a folder, not a file; check the path"


def test_a_damaged_entry_is_refused(pendulum: Path, tmp_path: Path) -> None:
    """One byte of the largest binary flipped: its checksum no longer fits."""
    content = bytearray(pendulum.read_bytes())
    with zipfile.ZipFile(pendulum) as zipped:
        info = max(zipped.infolist(), key=lambda each: each.compress_size)
    content[info.header_offset + 100 + info.compress_size // 2] ^= 0xFF
    path = tmp_path / "damaged.fmu"
    path.write_bytes(bytes(content))
    assert refusal(path).startswith(": contents: ")


def test_an_archive_without_model_description_is_refused(pendulum: Path, tmp_path: Path) -> None:
    path = changed(pendulum, tmp_path / "bare.fmu", lambda files: {n: b for n, b in files.items() if n != XML})
    assert refusal(path) == ": holds no modelDescription.xml; is it an FMU?"


BILLION_LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY lol "lol">'
    + "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10 if i else "&lol;" * 10}">' for i in range(10))
    + "]><fmiModelDescription>&l9;</fmiModelDescription>"
)
IN_ATTRIBUTE = BILLION_LAUGHS.replace(">&l9;<", ' modelName="&l9;"><')
EXTERNAL = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY f SYSTEM "file:///etc/hostname">]><a>&f;</a>'


@pytest.mark.parametrize(
    ("xml", "problem"),
    [
        ("", "is not XML"),
        ("not xml", "is not XML"),
        ("<fmiModelDescription>", "is not XML"),
        (BILLION_LAUGHS, "modelDescription.xml"),
        (IN_ATTRIBUTE, "modelDescription.xml"),
        (EXTERNAL, "declares a document type"),
        ("<a/>", "modelDescription.xml: "),
        ("<fmiModelDescription/>", "modelDescription.xml: "),
        ('<fmiModelDescription fmiVersion="4.0"/>', "Unsupported FMI version: 4.0"),
        ("<a>" * 5000 + "</a>" * 5000, "is not XML"),
    ],
    ids=["empty", "text", "open", "laughs", "laughs in an attribute", "external", "other", "bare", "version", "deep"],
)
def test_a_model_description_that_is_none_is_refused(pendulum: Path, tmp_path: Path, xml: str, problem: str) -> None:
    path = changed(pendulum, tmp_path / "xml.fmu", lambda files: {**files, XML: xml.encode()})
    assert problem in refusal(path)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="1.0" numberOfContinuousStates="0" modelIdentifier="pendulum"', "1.0"),
        ("<CoSimulation ", '<ModelExchange modelIdentifier="pendulum"/><!-- ', "is not XML"),
        ('valueReference="1"', 'valueReference="-1"', "angle: has the value reference -1"),
        ('valueReference="1"', 'valueReference="4294967296"', "has the value reference 4294967296"),
        ('valueReference="1"', 'valueReference="one"', "invalid literal"),
        ('name="speed"', 'name="angle"', "two variables are called 'angle'"),
        ('min="0.0"', 'min="low"', "min='low' is no number"),
        ('modelIdentifier="pendulum"', 'modelIdentifier="../../pendulum"', "model identifier '../../pendulum'"),
        ('modelIdentifier="pendulum"', 'modelIdentifier="other"', "has no binary for"),
        ('index="3"', 'index="300"', "modelDescription.xml: "),
    ],
)
def test_a_model_description_with_impossible_contents_is_refused(
    pendulum: Path, tmp_path: Path, old: str, new: str, problem: str
) -> None:
    assert problem in refusal(with_xml(pendulum, tmp_path / "bad.fmu", (old, new)))


def test_fmi_1_is_refused_by_name(pendulum: Path, tmp_path: Path) -> None:
    xml = (
        '<fmiModelDescription fmiVersion="1.0" modelName="old" modelIdentifier="old" guid="x" '
        'numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables/><Implementation/>'
        "</fmiModelDescription>"
    )
    path = changed(pendulum, tmp_path / "old.fmu", lambda files: {**files, XML: xml.encode()})
    assert refusal(path) == ": is of FMI version 1.0; export it for FMI 2.0 or 3.0"


def test_an_fmu_that_offers_neither_interface_is_refused(pendulum: Path, tmp_path: Path) -> None:
    path = with_xml(pendulum, tmp_path / "neither.fmu", ("<CoSimulation ", "<ScheduledExecution "))
    assert refusal(path) == ": offers neither co-simulation nor model exchange; export it for one of them"


def test_an_fmu_without_a_binary_for_this_platform_is_refused_with_those_it_has() -> None:
    message = refusal(third_party.coupled_clutches_for_windows())
    assert message.startswith(": has no binary for ")
    assert message.endswith("(it has: win64); export it for this platform")


@pytest.mark.parametrize("name", ["../outside.txt", "/outside.txt", "a/../../b", "..\\outside", "c:\\outside"])
def test_paths_that_leave_the_archive_are_refused(pendulum: Path, tmp_path: Path, name: str) -> None:
    path = changed(pendulum, tmp_path / "slip.fmu", lambda files: {**files, name: b"x"})
    assert "that leaves the archive; do not trust it" in refusal(path)


def test_an_archive_that_claims_to_unpack_to_more_than_four_gibibytes_is_refused(
    pendulum: Path, tmp_path: Path
) -> None:
    content = bytearray(pendulum.read_bytes())
    at = content.index(b"PK\x01\x02")
    for _ in range(3):  # uncompressed size in the central directory
        struct.pack_into("<I", content, at + 24, 0xF0000000)
        at = content.index(b"PK\x01\x02", at + 4)
    path = tmp_path / "bomb.fmu"
    path.write_bytes(bytes(content))
    with zipfile.ZipFile(pendulum) as sound:
        claimed = 3 * 0xF0000000 + sum(entry.file_size for entry in sound.infolist()[3:])
    assert refusal(path) == f": unpacks to {claimed:,} bytes, more than 4 GiB; do not trust it"


def test_a_file_where_another_entry_needs_a_folder_is_refused(pendulum: Path, tmp_path: Path) -> None:
    path = changed(pendulum, tmp_path / "clash.fmu", lambda files: {**files, "resources": b"a file"})
    assert refusal(path).startswith(": contents: ")


def test_a_name_too_long_for_the_file_system_is_refused(pendulum: Path, tmp_path: Path) -> None:
    path = changed(pendulum, tmp_path / "long.fmu", lambda files: {**files, "x" * 5000: b""})
    assert refusal(path).startswith(": contents: ")


def test_a_description_can_be_read_without_a_binary_for_this_platform() -> None:
    assert read_description(third_party.coupled_clutches_for_windows()).modelName == "CoupledClutches"


def opens_or_is_refused(path: Path) -> None:
    try:
        FmuFile(path).close()
    except (FmuFileError, FmuError) as error:
        assert "\n" not in str(error)


FUZZ = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def small(pendulum: Path) -> bytes:
    """The FMU with only the binary for this platform's name, and that empty: fast to write and to open."""
    files = {
        name: b"" if name.startswith("binaries/") else content
        for name, content in archive.read(pendulum).items()
        if not name.startswith("resources/pythonfmu")
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as zipped:
        for name, content in files.items():
            zipped.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.slow
@FUZZ
@given(data=st.data())
def test_whatever_bytes_are_changed_a_file_opens_or_is_refused(
    pendulum: Path, tmp_path: Path, data: st.DataObject
) -> None:
    content = bytearray(small(pendulum))
    places = st.one_of(st.integers(0, len(content) - 1), st.integers(max(0, len(content) - 1500), len(content) - 1))
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(places)] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        at = data.draw(places)
        content[at : at + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=40))
    path = tmp_path / "fuzzed.fmu"
    path.write_bytes(bytes(content))
    opens_or_is_refused(path)


HOSTILE = st.sampled_from(
    [
        "",
        "-1",
        "nan",
        "1e999",
        "99999999999999999999",
        "true",
        "2.0",
        "3.0",
        "\u0000".join("ab"),
        "../x",
        "&#1;",
        "'",
        "Real",
    ]
)


@pytest.mark.slow
@FUZZ
@given(data=st.data())
def test_whatever_attribute_is_changed_a_file_opens_or_is_refused(
    pendulum: Path, tmp_path: Path, data: st.DataObject
) -> None:
    files = {
        name: b"" if name.startswith("binaries/") else content
        for name, content in archive.read(pendulum).items()
        if not name.startswith("resources/")
    }
    parts = files[XML].decode().split('"')
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(parts) - 1))
        parts[at] = data.draw(st.one_of(HOSTILE, st.just(parts[data.draw(st.integers(0, len(parts) - 1))])))
    archive.write(tmp_path / "fuzzed.fmu", {**files, XML: '"'.join(parts).encode(errors="replace")})
    opens_or_is_refused(tmp_path / "fuzzed.fmu")


def test_a_binary_that_is_none_is_an_fmu_error_and_the_working_directory_stays(pendulum: Path, tmp_path: Path) -> None:
    here = Path.cwd()
    path = tmp_path / "hollow.fmu"
    path.write_bytes(small(pendulum))
    with FmuFile(path) as fmu, pytest.raises(FmuError, match=r"^hollow: instantiate: Failed to load shared library"):
        Slave(fmu, "hollow")
    assert Path.cwd() == here


@pytest.mark.slow
def test_so_many_variables_that_memory_is_too_small_are_refused_before_they_take_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variable = '<ScalarVariable name="v%d" valueReference="%d" causality="local"><Real/></ScalarVariable>'
    variables = "".join(variable % (number, number) for number in range(600_000))
    head = '<fmiModelDescription fmiVersion="2.0" modelName="big" guid="g"><CoSimulation modelIdentifier="big"/>'
    xml = f"{head}<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"
    archive.write(tmp_path / "big.fmu", {XML: xml.encode()})
    assert (tmp_path / "big.fmu").stat().st_size < len(xml) / 10
    monkeypatch.setattr("orchestrator.processes.memory.available", lambda: 1e9)
    monkeypatch.setattr(archive, "parse_xml", None)
    with pytest.raises(InputError, match=r"bytes would take 1\.\d+ GB of memory, 1 GB are there; have fewer variables"):
        read_description(tmp_path / "big.fmu")
