"""FMU files from outside: what is wrong with them is one line, whatever it is."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, FmuFileError, InputError
from fmus.packaging import archive
from orchestrator.fmi.file import FmuFile, read_description
from orchestrator.fmi.slave import Slave
from tests.support.simulation.changed import XML, changed, refusal, with_xml
from tests.support.tools import third_party


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
        ('name="angle"', 'name=""', "the variable with the value reference 1 has no name"),
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
