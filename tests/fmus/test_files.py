"""Files are there as a whole or not at all."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import BinaryIO

import pytest

from fmus import owned
from fmus.errors import InputError
from fmus.files import atomic_write, sha256


def test_a_file_that_fails_while_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "kept.bin"
    path.write_bytes(b"old")

    def fail(file: BinaryIO) -> None:
        file.write(b"half")
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        atomic_write(path, fail)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_replaced_and_its_folder_made(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "x.bin"
    atomic_write(path, b"old")
    atomic_write(path, lambda file: file.write(b"new"))
    assert path.read_bytes() == b"new"


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="cannot be written"):
        atomic_write(tmp_path / "file" / "below", b"")
    with pytest.raises(InputError, match="cannot be read"):
        sha256(tmp_path / "absent")


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes and links")
def test_a_pipe_is_not_replaced_and_a_link_stays_one(tmp_path: Path) -> None:
    pipe, link, file = tmp_path / "pipe", tmp_path / "link", tmp_path / "folder" / "file"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="is a pipe, a device or a socket, not a file"):
        atomic_write(pipe, b"new")
    assert pipe.is_fifo()
    link.symlink_to(file)
    atomic_write(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.skipif(sys.platform == "win32", reason="needs locks of files")
def test_parts_that_dead_processes_left_go_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    left, young, held, other = (
        tmp_path / f".{name}.part" for name in ("a.b.01234567", "a.b.89abcdef", "a.b.fedcba98", "a.b")
    )
    for part in (left, young, held, other):
        part.write_bytes(b"half")
        os.utime(part, None if part is young else (0, 0))
    with held.open("rb") as file:
        owned.hold(file)
        atomic_write(tmp_path / "a.b", b"whole")
    assert {*tmp_path.iterdir()} == {tmp_path / "a.b", young, held, other}
