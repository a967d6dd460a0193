"""Of a database that ends too early what is lost is told, wherever it ends."""

from __future__ import annotations

import re
from pathlib import Path

import cantools
import pytest

from fmus.errors import DatabaseError
from orchestrator.can.database.database import Database, load

DBC = """VERSION ""
BS_:
BU_: rig
BO_ 331 State: 8 rig
 SG_ angle : 0|32@1- (1,0) [0|0] "rad" rig
 SG_ speed : 32|16@1- (0.01,0) [-320|320] "rad/s" rig
BO_ 332 Muxed: 8 rig
 SG_ m M : 0|8@1+ (1,0) [0|0] "" rig
 SG_ q m1 : 8|8@1+ (1,0) [0|0] "" rig
VAL_ 331 speed 0 "off" 1 "on" ;
SIG_VALTYPE_ 331 angle : 1;
SG_MUL_VAL_ 332 q m 1-3;
"""
WHOLE = [match.end() for match in re.finditer(r"rig(?=\n)|;", DBC)]
"""Where a statement has just ended: nobody can tell that there were others."""


def cut(folder: Path, text: str, suffix: str) -> Database | None:
    """The database in a text, None where it is refused."""
    path = folder / f"a{suffix}"
    path.write_text(text)
    try:
        return load(path)
    except DatabaseError:
        return None


def test_a_dbc_that_ends_within_a_statement_says_so(tmp_path: Path) -> None:
    silent = []
    for end in range(1, len(DBC)):
        found = cut(tmp_path, DBC[:end], ".dbc")
        whole = any(DBC[place:end].strip() == "" for place in WHOLE if place <= end)
        within_a_name = re.search(r'" \w+$', DBC[:end])  # of a node, which does not matter
        if found is not None and not found.notes and not whole and not within_a_name and " SG_" in DBC[:end]:
            silent.append(DBC[:end][-20:])
    assert [text for text in silent if not re.search(r"BO_ \d+ \w+: 8 (r|ri|rig\n| rig\n )?\s*$", text)] == []


def test_a_signal_that_may_be_a_float_is_left_out_where_the_line_that_says_so_is_cut(tmp_path: Path) -> None:
    end = DBC.index("angle : 1;")
    found = cut(tmp_path, DBC[: end + 8], ".dbc")
    assert found is not None and [message.name for message in found.messages] == ["Muxed"]
    assert any("State is left out: the file ends within it" in note for note in found.notes)


def test_a_sym_whose_last_line_has_no_end_says_so(tmp_path: Path) -> None:
    text = cantools.database.load_string(DBC, "dbc").as_sym_string().rstrip() + "\n"
    begin = text.index("{SENDRECEIVE}")
    whole = cut(tmp_path, text, ".sym")
    assert whole is not None and not whole.notes
    for end in range(begin + 20, len(text)):
        found = cut(tmp_path, text[:end], ".sym")
        assert found is None or text[end - 1] == "\n" or any("has no end" in note for note in found.notes)


@pytest.mark.parametrize("suffix", [".dbc", ".sym", ".kcd"])
def test_a_signal_whose_factor_is_0_is_left_out_and_told(tmp_path: Path, suffix: str) -> None:
    database = cantools.database.load_string(DBC.replace("(0.01,0)", "(0,5)"), "dbc")
    text = {".dbc": database.as_dbc_string, ".sym": database.as_sym_string, ".kcd": database.as_kcd_string}[suffix]()
    found = cut(tmp_path, text + "\n", suffix)
    assert found is not None
    assert any("State.speed is left out: its factor is 0, whatever it holds would be 5" in note for note in found.notes)
    with pytest.raises(DatabaseError, match="its factor is 0"):
        found.signal("State.speed")
