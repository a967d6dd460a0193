"""Texts from outside are read by what their bytes are, alike in a database and in a table; a guess is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.encodings import SAMPLE, Encoding, decoded, encoding_of
from fmus.errors import TraceError
from orchestrator.can.database.reading import text_of
from orchestrator.formats.layout import Layout
from orchestrator.formats.texts import reading

TEXTS = {
    "utf-8": "Drehzahl über Größe, 速度",
    "utf-16": "Zeit, Größe",
    "cp1252": "Drehzahl über Größe [°/s] [µm]",
    "gb18030": "时间,转速",
    "cp949": "시간,회전속도,온도",
    "cp932": "時間,回転数",
    "cp1251": "скорость",
}


@given(data=st.binary(max_size=300), unit=st.sampled_from(["°C".encode("gb18030"), "µm²".encode("cp1252"), b"\xff"]))
def test_whatever_the_bytes_are_they_are_read_by_an_encoding_that_takes_them(data: bytes, unit: bytes) -> None:
    plain = b'BO_ 1 "' + unit + b'" ' + data.replace(b'"', b"").replace(b"\0", b"")
    text, guess = text_of(Path("bus.dbc"), plain, None)
    assert text and "is a guess" in guess


@pytest.mark.parametrize(("encoding", "text"), TEXTS.items())
def test_a_table_and_a_database_are_read_by_the_same_encoding(encoding: str, text: str, tmp_path: Path) -> None:
    """The table refuses what may be another one: its headings are names that the user's files have to meet."""
    row = "0," * len(text.split(","))
    raw = f"a,{text}\n0,{row}\n1,{row}\n".replace(",\n", "\n").encode(encoding)
    seen = encoding_of(raw)
    assert decoded(raw, seen.name) == raw.decode(encoding)
    assert text_of(Path("bus.dbc"), raw, None)[0] == raw.decode(encoding)
    (tmp_path / "log.csv").write_bytes(raw)
    if seen.sure:
        assert reading.read(tmp_path / "log.csv", Layout(time="a")).trace.names
    else:
        assert encoding in ("cp949", "cp932", "cp1251")
        with pytest.raises(TraceError, match=rf"nor surely .* say its `encoding` \(most like {encoding}\)"):
            reading.read(tmp_path / "log.csv", Layout(time="a"))


def test_a_sign_of_chinese_tables_is_not_taken_for_two_western_ones() -> None:
    assert encoding_of("[℃]".encode("gb18030")).name == "gb18030"
    assert encoding_of("[°C]".encode("cp1252")) == Encoding("cp1252")


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=50), st.integers(0, 3))
def test_a_text_that_is_cut_within_a_character_is_still_utf_8(text: str, cut: int) -> None:
    raw = (text + "速").encode()
    assert encoding_of(raw[: len(raw) - cut] if cut else raw, whole=False).name.startswith("utf-8")
    assert decoded(("x" * SAMPLE + "速").encode()[:-1], "utf-8", whole=False) == "x" * SAMPLE
