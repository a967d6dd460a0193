"""Archives from outside are hostile until shown otherwise; archives we write are the same bytes each time."""

from __future__ import annotations

import warnings
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuFileError
from fmus.packaging import archive

FILES = {"modelDescription.xml": b"<fmiModelDescription/>", "resources/a.txt": b"a" * 5000, "empty": b""}


def zipped(path: Path, *names: str) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name in names:
            file.writestr(zipfile.ZipInfo(name), b"content")
    return path


def refusal(path: Path) -> str:
    """The one line with which reading the archive is refused."""
    with pytest.raises(FmuFileError) as error:
        archive.read(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.slow
@given(st.dictionaries(st.from_regex(r"[a-z]{1,8}(/[a-z]{1,8}){0,2}\.txt", fullmatch=True), st.binary(max_size=200)))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, files: dict[str, bytes]) -> None:
    path = tmp_path_factory.mktemp("zip") / "a.fmu"
    archive.write(path, files)
    assert archive.read(path) == files


def test_equal_contents_are_equal_bytes_whatever_their_order(tmp_path: Path) -> None:
    archive.write(tmp_path / "a.fmu", FILES)
    archive.write(tmp_path / "b.fmu", dict(reversed(FILES.items())))
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()


def test_writing_makes_the_folder_and_leaves_nothing_beside_the_file(tmp_path: Path) -> None:
    archive.write(tmp_path / "new" / "a.fmu", FILES)
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["a.fmu"]


def test_a_write_that_fails_keeps_the_old_file_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    archive.write(path, FILES)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        archive.write(path, {"a": b"new", "b": None})  # type: ignore[dict-item]
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.fmu"]


@pytest.mark.parametrize(
    "name",
    [
        "../evil",
        "a/../../evil",
        "..",
        "resources/..",
        "/etc/passwd",
        "C:/evil",
        "c:evil",
        "..\\evil",
        "a\\..\\..\\evil",
        "\\evil",
        "\\\\server\\evil",
        "C:\\evil",
    ],
)
def test_a_path_that_leaves_the_archive_is_refused(tmp_path: Path, name: str) -> None:
    message = refusal(zipped(tmp_path / "a.fmu", "modelDescription.xml", name))
    assert "that leaves the archive; do not trust it" in message


@pytest.mark.parametrize("name", ["..a", "a..b/c", "resources/...", "a/b:c"])
def test_a_strange_name_that_stays_inside_is_read(tmp_path: Path, name: str) -> None:
    assert name in archive.read(zipped(tmp_path / "a.fmu", name))


def entries(path: Path, *pairs: tuple[str, bytes]) -> Path:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as file:
        warnings.simplefilter("ignore")  # zipfile's about names that are there twice
        for name, content in pairs:
            file.writestr(zipfile.ZipInfo(name), content)
    return path


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ("modelDescription.xml", "modelDescription.xml", "'modelDescription.xml' twice"),
        ("modelDescription.xml", "./modelDescription.xml", "'modelDescription.xml' twice"),
        ("modelDescription.xml", "ModelDescription.xml", "'modelDescription.xml' and 'ModelDescription.xml'"),
        ("binaries/linux64/a.so", "binaries\\linux64\\a.so", "'binaries/linux64/a.so' twice"),
        ("binaries/linux64/a.so", "Binaries/Linux64/A.so", "'binaries/linux64/a.so' and 'binaries/linux64/A.so'"),
        ("resources/a.txt", "Resources/a.txt", "'resources/a.txt' twice"),
    ],
)
def test_two_entries_of_which_one_counts_are_refused(tmp_path: Path, first: str, second: str, told: str) -> None:
    message = refusal(entries(tmp_path / "a.fmu", (first, b"one"), (second, b"two")))
    assert f"holds {told}, with different contents; zip it again" in message


def test_an_entry_that_is_there_twice_and_the_same_is_read_once(tmp_path: Path) -> None:
    path = entries(tmp_path / "a.fmu", ("a", b"one"), ("a", b"one"), ("b/", b""), ("b/", b""))
    assert archive.read(path) == {"a": b"one"} and len(archive.opened(path).infolist()) == 2


def test_resources_that_differ_in_case_are_told_once_and_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = entries(tmp_path / "a.fmu", ("resources/a.txt", b"one"), ("resources/A.txt", b"two"))
    assert archive.read(path) == archive.read(path) == {"resources/a.txt": b"one", "resources/A.txt": b"two"}
    assert [record.getMessage() for record in caplog.records] == [
        f"{path}: holds 'resources/a.txt' and 'resources/A.txt', which are one file on Windows"
    ]


def test_a_missing_file_and_a_folder_are_no_archives(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "none.fmu")
    assert "is a folder, not a file" in refusal(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a zip at all", b"PK\x03\x04"])
def test_what_is_no_zip_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.fmu"
    path.write_bytes(content)
    assert "is not a zip archive" in refusal(path)


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_zip_is_refused(tmp_path: Path, kept: float) -> None:
    path = tmp_path / "a.fmu"
    archive.write(path, FILES)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    assert "is not a zip archive" in refusal(path)


def test_damaged_contents_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    archive.write(path, {"a": bytes(range(256)) * 20})
    content = bytearray(path.read_bytes())
    content[60:90] = bytes(30)
    path.write_bytes(bytes(content))
    assert "cannot be unpacked" in refusal(path)


def test_names_that_are_not_in_the_encoding_they_claim_are_refused(tmp_path: Path) -> None:
    for place in (b"PK\x03\x04", b"PK\x01\x02"):  # beside the contents, and in the table of contents
        path = tmp_path / "names.fmu"
        archive.write(path, {"modelDescription.xml": b"<x/>"})
        content = bytearray(path.read_bytes())
        start = content.index(place)
        flags, name = (6, 30) if place[2] == 3 else (8, 46)
        content[start + flags + 1] |= 0x08
        content[start + name : start + name + 2] = b"\xed\xff"
        path.write_bytes(content)
        with pytest.raises(FmuFileError, match="decode"):
            archive.read(path)


def test_an_encrypted_file_is_refused(tmp_path: Path) -> None:
    path = zipped(tmp_path / "a.fmu", "a")
    content = bytearray(path.read_bytes())
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(bytes(content))
    assert "cannot be unpacked" in refusal(path)


def test_more_than_the_limit_is_refused_before_anything_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.fmu"
    archive.write(path, {"a": bytes(1000), "b": bytes(1000)})
    monkeypatch.setattr(archive, "LARGEST_UNPACKED", 2000)
    assert len(archive.read(path)) == 2
    monkeypatch.setattr(archive, "LARGEST_UNPACKED", 1999)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("was unpacked"))
    assert "unpacks to 2,000 bytes, more than" in refusal(path)


@pytest.mark.parametrize(
    ("limit", "value", "told"),
    [("MOST_ENTRIES", 2, "holds 3 files, more than 2"), ("SMALL", 1000, r"unpacks to \d\d\d times its size")],
)
def test_what_unpacks_to_too_much_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int, told: str
) -> None:
    monkeypatch.setattr(archive, limit, value)
    archive.write(tmp_path / "bomb.fmu", {"a": bytes(1_000_000), "b": b"", "c": b""})
    with pytest.raises(FmuFileError, match=f"bomb.fmu: {told}; do not trust it"):
        archive.read(tmp_path / "bomb.fmu")
