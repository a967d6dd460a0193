"""A record that grows can be read whatever its writer came to, up to the last piece that is whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator import formats
from orchestrator.formats import arrows
from orchestrator.trace import Trace


def piece(number: int) -> Trace:
    time = 0.1 * np.arange(10 * number, 10 * number + 10)
    return Trace(time, {"a.x": np.sin(time), "a.y": time**2}, {"a.x": "rad"})


@pytest.fixture
def record(tmp_path: Path) -> Path:
    """Five pieces of ten rows, not closed."""
    path, copy = tmp_path / "growing.arrows", tmp_path / "record.arrows"
    with arrows.appending(path) as append:
        for number in range(5):
            append(piece(number))
        copy.write_bytes(path.read_bytes())
    return copy


def test_it_is_read_while_it_grows(record: Path) -> None:
    trace = formats.read(record).trace
    assert len(trace) == 50 and trace.unit("a.x") == "rad"
    assert trace["a.y"].tobytes() == np.concatenate([piece(number)["a.y"] for number in range(5)]).tobytes()


def test_where_it_breaks_off_what_is_whole_is_read_and_that_is_said(record: Path, tmp_path: Path) -> None:
    whole, lengths, told = record.read_bytes(), set[int](), set[str]()
    for size in range(len(whole) - 1, len(whole) // 3, -37):
        record.write_bytes(whole[:size])
        recording = formats.read(record)
        lengths.add(len(recording.trace))
        assert len(recording.trace) % 10 == 0
        told |= {str(note) for note in recording.notes}
    assert len(lengths) >= 3 and told == {"breaks off within a piece, which is left out"}


def test_without_rows_or_as_something_else_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "no.arrows"
    for content in (b"PAR1 and more that is none", b"\xff\xff\xff\xff\x10\0\0\0"):
        path.write_bytes(content)
        with pytest.raises(TraceError, match=r"no\.arrows: (is not a readable Arrow stream|holds no rows)"):
            formats.read(path)
