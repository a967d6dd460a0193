"""Bytes of database files become text whatever they are, and a guess is told."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can.database.encoding import text_of


@given(data=st.binary(max_size=300), unit=st.sampled_from(["°C".encode("gb18030"), "µm²".encode("cp1252"), b"\xff"]))
def test_whatever_the_bytes_are_they_are_read_by_an_encoding_that_takes_them(data: bytes, unit: bytes) -> None:
    plain = b'BO_ 1 "' + unit + b'" ' + data.replace(b'"', b"")
    text, guess = text_of(Path("bus.dbc"), plain, None)
    assert text and "is a guess" in guess
