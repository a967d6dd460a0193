"""What AUTOSAR files say in other ways than cantools reads: no scaling, unit or sign is lost without a word."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orchestrator.can.database import database
from orchestrator.can.database.database import Database

ARXML = (Path(__file__).parent / "state.arxml").read_text()
PHYSICAL = re.search(r"\s*<PHYSICAL-PROPS>.*?</PHYSICAL-PROPS>", ARXML, re.DOTALL)


def loaded(folder: Path, text: str) -> Database:
    path = folder / "rig.arxml"
    path.write_text(text)
    return database.load(path)


def scaled(base: Database) -> tuple[float, str, bool]:
    signal = base.signal("angle")[1]
    return signal.scale, signal.unit, signal.is_signed


def test_a_scaling_and_a_unit_on_the_bus_alone_count(tmp_path: Path) -> None:
    assert PHYSICAL is not None
    bare = ARXML.replace(PHYSICAL[0], "")
    assert scaled(loaded(tmp_path, bare)) == scaled(loaded(tmp_path, ARXML)) == (1e-4, "rad", True)


@pytest.mark.parametrize(
    "category",
    ["", "<CATEGORY>RAT_FUNC</CATEGORY>", "<CATEGORY>SCALE_LINEAR</CATEGORY>"],
)
def test_a_quotient_that_is_linear_is_a_scaling_whatever_its_category(tmp_path: Path, category: str) -> None:
    text = ARXML.replace("<CATEGORY>LINEAR</CATEGORY>", category).replace("<V>1</V>", "<V>2</V><V>0.0</V>")
    base = loaded(tmp_path, text)
    assert scaled(base) == (5e-5, "rad", True)
    assert not base.notes


@pytest.mark.parametrize(
    ("category", "coefficients"),
    [("RAT_FUNC", "<V>1</V><V>0.5</V>"), ("TAB_NOINTP", "<V>1</V><V>0.5</V>")],
)
def test_other_conversions_are_told_and_leave_what_is_on_the_bus(
    tmp_path: Path, category: str, coefficients: str
) -> None:
    text = ARXML.replace("LINEAR</CATEGORY>", f"{category}</CATEGORY>").replace("<V>1</V>", coefficients)
    base = loaded(tmp_path, text)
    assert scaled(base)[0] == 1
    assert any("AngleScale" in note and "as they are on the bus" in note for note in base.notes)


def test_of_a_conversion_in_pieces_no_piece_counts_for_all(tmp_path: Path) -> None:
    piece = re.search(r"<COMPU-SCALE>.*?</COMPU-SCALE>", ARXML, re.DOTALL)
    assert piece is not None
    base = loaded(tmp_path, ARXML.replace(piece[0], piece[0] + piece[0].replace("0.0001", "0.5")))
    assert scaled(base)[0] == 1
    assert any("AngleScale" in note for note in base.notes)


@pytest.mark.parametrize(("name", "signed"), [("sint16", True), ("S16", True), ("A_UINT16_T", False)])
def test_the_name_of_a_base_type_tells_its_sign_where_no_encoding_does(tmp_path: Path, name: str, signed: bool) -> None:
    text = re.sub(r"\s*<BASE-TYPE-ENCODING>.*?</BASE-TYPE-ENCODING>", "", ARXML)
    text = text.replace("<SHORT-NAME>S16</SHORT-NAME>", f"<SHORT-NAME>{name}</SHORT-NAME>")
    base = loaded(tmp_path, text.replace("/Rig/S16", f"/Rig/{name}"))
    assert scaled(base)[2] is signed
    assert any(f"{name} as {'signed' if signed else 'unsigned'}" in note for note in base.notes)
