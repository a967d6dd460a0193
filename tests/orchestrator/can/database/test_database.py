"""A database says what it holds, and a bad file where it is bad; nothing that is read hangs or fills the memory."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import cantools
import pytest
from cantools.database.can import Message, Signal
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import DatabaseError
from orchestrator.can.database import database
from orchestrator.can.database.bus import load_all
from orchestrator.can.database.database import Database
from orchestrator.can.database.interpretation import protected
from orchestrator.can.database.protection import Protection
from orchestrator.can.database.sources import parsed, paths

DBC = """VERSION ""
BU_: A B
BO_ 100 State: 8 A
 SG_ angle : 0|16@1- (0.1,0) [-100|100] "rad" B
 SG_ torque : 23|16@0- (0.5,1) [0|0] "Nm" B
 SG_ alive_counter : 32|4@1+ (1,0) [0|14] "" B
 SG_ crc : 56|8@1+ (1,0) [0|0] "" B
BO_ 2147484000 Command: 8 A
 SG_ voltage : 0|16@1- (0.001,0) [-24|24] "V" B
 SG_ status : 16|8@1+ (1,0) [5|5] "" B
BO_ 102 Status: 2 A
 SG_ status : 0|8@1+ (1,0) [0|0] "" B
 SG_ Encoder_Counter : 8|8@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "ChecksumSignal" STRING ;
BA_DEF_ BO_ "ChecksumAlgorithm" STRING ;
BA_DEF_ BO_ "CounterSignal" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_DEF_DEF_ "ChecksumAlgorithm" "";
BA_DEF_DEF_ "CounterSignal" "";
BA_ "GenMsgCycleTime" BO_ 100 10;
BA_ "ChecksumSignal" BO_ 100 "crc";
BA_ "ChecksumAlgorithm" BO_ 100 "CRC8_H2F";
BA_ "CounterSignal" BO_ 100 "alive_counter";
VAL_ 102 status 0 "off" 1 "on" ;
"""

KCD = """<?xml version="1.0" encoding="UTF-8"?>
<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">
  <Document name="n" version="1">text</Document>
  <Bus name="b"><Message id="0x10" name="State" length="4"><Signal name="angle" offset="8" length="16"/></Message></Bus>
</NetworkDefinition>
"""

SYM = """FormatVersion=6.0 // Do not edit this line!
Title="rig"

{SENDRECEIVE}
[State]
ID=010h
Len=4
Var=angle unsigned 8,16
"""


ARXML = (Path(__file__).parent / "state.arxml").read_text()


def file(folder: Path, text: str, suffix: str = ".dbc", encoding: str = "utf-8") -> Path:
    path = folder / f"rig{suffix}"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.fixture
def base(tmp_path: Path) -> Database:
    return database.load(file(tmp_path, DBC))


def test_messages_and_signals_carry_what_the_file_says(base: Database) -> None:
    state, command, status = base.messages
    assert (state.id, state.extended, state.length, state.cycle, state.fd) == (100, False, 8, 0.01, False)
    assert (command.id, command.extended, command.cycle) == (352, True, None)
    angle, torque = state.signal("angle"), state.signal("torque")
    assert (angle.unit, angle.minimum, angle.maximum, angle.scale, angle.is_signed) == ("rad", -100, 100, 0.1, True)
    assert (torque.unit, torque.minimum, torque.big_endian, torque.lowest) == ("Nm", None, True, 31)
    assert status.signal("status").choices == {0: "off", 1: "on"}
    assert command.signal("status").minimum is command.signal("status").maximum is None


def test_a_signal_of_two_messages_is_known_by_its_message(base: Database) -> None:
    assert base.signal("angle")[0].name == base.signal("State.angle")[0].name == "State"
    assert base.public_name(*base.signal("State.angle")) == "angle"
    assert base.public_name(*base.signal("Command.status")) == "Command.status"
    with pytest.raises(DatabaseError, match=r"'status' is in 2 messages; write 'Command.status' or 'Status.status'"):
        base.signal("status")


@pytest.mark.parametrize(
    ("name", "hint"),
    [("angel", "did you mean 'angle'"), ("State.angel", "did you mean 'angle'"), ("zzz", "it has angle, torque")],
)
def test_an_unknown_signal_is_refused_with_close_names(base: Database, name: str, hint: str) -> None:
    with pytest.raises(DatabaseError, match=hint):
        base.signal(name)


def test_an_unknown_message_is_refused_with_close_names(base: Database) -> None:
    with pytest.raises(DatabaseError, match=r"has no message 'Stat'; did you mean 'State'"):
        base.message("Stat")


def test_attributes_and_names_tell_what_protects_a_message(base: Database) -> None:
    assert base.message("State").protection == Protection("alive_counter", 15, "crc", "CRC8_H2F")
    assert base.message("Status").protection is None  # an encoder's count is no counter of messages


def test_a_counter_goes_by_its_usual_name(tmp_path: Path) -> None:
    text = DBC.partition("BA_DEF_")[0]
    assert database.load(file(tmp_path, text)).message("State").protection == Protection("alive_counter", 15)


def test_protection_can_be_given_and_is_checked(base: Database) -> None:
    given = protected(base.path, base.message("Status"), Protection("Encoder_Counter"))
    assert given.protection == Protection("Encoder_Counter", 256)
    for wrong, problem in [
        (Protection("angle"), "no plain unsigned counter"),
        (Protection("none"), "has no signal"),
        (Protection("alive_counter", 17), "cannot have 17 values"),
        (Protection(checksum="alive_counter"), "no checksum of one whole byte"),
        (Protection(checksum="crc", algorithm="CRC9"), "there is no checksum 'CRC9'"),
        (Protection(checksum="crc", data_id=1 << 16), "has not 16 bits"),
    ]:
        with pytest.raises(DatabaseError, match=problem):
            protected(base.path, base.message("State"), wrong)


def test_what_autosar_has_beside_can_is_no_fault(tmp_path: Path) -> None:
    payload = "<I-SIGNAL><SHORT-NAME>Diagnosis</SHORT-NAME><LENGTH>32760</LENGTH></I-SIGNAL>"
    at = ARXML.index("<I-SIGNAL>")
    assert database.load(file(tmp_path, ARXML[:at] + payload + ARXML[at:], ".arxml")).signal("angle")
    for wrong in (payload.replace("32760", "999999"), payload.replace("32760", "524280") * 65):
        with pytest.raises(DatabaseError, match="more than any frame has"):
            database.load(file(tmp_path, ARXML[:at] + wrong + ARXML[at:], ".arxml"))


@pytest.mark.parametrize(("suffix", "text"), [(".kcd", KCD), (".sym", SYM), (".arxml", ARXML)])
def test_other_formats_give_the_same_signal(tmp_path: Path, suffix: str, text: str) -> None:
    message, signal = database.load(file(tmp_path, text, suffix)).signal("angle")
    assert (message.name, message.id, message.length, signal.lowest, signal.length) == ("State", 16, 4, 8, 16)


@pytest.mark.parametrize(
    ("encoding", "guess", "comment", "unit"),
    [
        ("gbk", "gb18030", "电机转速", "℃"),
        ("gb2312", "gb18030", "", "℃"),
        ("cp932", "cp932", "回転速度を表示する", "℃"),  # with bytes that are a backslash
        ("cp1251", "cp1251", "обороты двигателя", "об/мин"),
        ("cp1250", "cp1250", "měření rychlosti otáček", "ot"),
        ("cp1252", "cp1252", "Drehzahl für", "°/s"),
        ("utf-16", "", "回転速度", "°"),
    ],
)
def test_an_encoding_is_guessed_and_told_or_given(
    tmp_path: Path, encoding: str, guess: str, comment: str, unit: str
) -> None:
    text = DBC.replace(
        'SG_ angle : 0|16@1- (0.1,0) [-100|100] "rad"', f'SG_ angle : 0|16@1- (0.1,0) [-100|100] "{unit}"'
    )
    path = file(
        tmp_path,
        text + f'CM_ SG_ 100 angle "{comment} ソ能";\n'.replace(" ソ能" if encoding != "cp932" else "", ""),
        encoding=encoding,
    )
    for read in (database.load(path), database.load(path, encoding=encoding)):
        angle = read.signal("angle")[1]
        assert (angle.unit, angle.comment[: len(comment)]) == (unit, comment)
        assert [m.name for m in read.messages] == ["State", "Command", "Status"]
    assert database.load(path, encoding=encoding).notes == ()
    assert [guess in note for note in database.load(path).notes] == ([True] if guess else [])


def test_several_buses_in_one_file_are_told(tmp_path: Path) -> None:
    other = '<Bus name="c"><Message id="0x11" name="B" length="1"><Signal name="x" offset="0"/></Message></Bus>'
    found = database.load(file(tmp_path, KCD.replace("</NetworkDefinition>", f"{other}</NetworkDefinition>"), ".kcd"))
    assert [message.name for message in found.messages] == ["State", "B"]
    assert "holds the buses b, c, whose messages are taken for those of one" in found.notes[0]
    assert "--dbc 0=rig.kcd#b --dbc 1=rig.kcd#c gives each channel its own bus" in found.notes[0]
    assert database.load(file(tmp_path, KCD, ".kcd")).notes == ()


def test_one_bus_of_a_file_is_chosen_by_its_name_for_each_channel(tmp_path: Path) -> None:
    """Two buses use one identifier for different messages, which each channel decodes by its own."""
    other = '<Bus name="c"><Message id="0x10" name="B" length="1"><Signal name="x" offset="0"/></Message></Bus>'
    path = file(tmp_path, KCD.replace("</NetworkDefinition>", f"{other}</NetworkDefinition>"), ".kcd")
    assert "0x10 of State, which is used" in " ".join(database.load(path).notes)
    chosen = load_all(parsed([f"0={path}#b", f"1={path}#c"]))
    assert [[m.name for m in chosen.of(n, "").messages] for n in (0, 1)] == [["State"], ["B"]]  # type: ignore[union-attr]
    assert (chosen.notes, paths(parsed([f"0={path}#b", f"1={path}#c"]))) == ([], [path])
    with pytest.raises(DatabaseError, match="has no bus 'd'; it has b, c"):
        database.load(path.with_name(f"{path.name}#d"))


def test_xml_is_read_in_the_encoding_that_it_names(tmp_path: Path) -> None:
    text = (
        KCD.replace("UTF-8", "gb2312")
        .replace('length="16"', 'length="16"')
        .replace("/></Message>", "><Notes>转速</Notes></Signal></Message>")
    )
    assert database.load(file(tmp_path, text, ".kcd", "gb2312")).signal("angle")[1].comment == "转速"


def test_units_in_either_encoding_are_read(tmp_path: Path) -> None:
    for encoding in ("utf-8", "cp1252"):
        text = DBC.replace('"rad"', '"°"')
        assert database.load(file(tmp_path, text, encoding=encoding)).signal("angle")[1].unit == "°"
    with pytest.raises(DatabaseError, match="no encoding 'utf-99'"):
        database.load(file(tmp_path, DBC), encoding="utf-99")
    with pytest.raises(DatabaseError, match="is not ascii"):
        database.load(file(tmp_path, DBC.replace("rad", "°")), encoding="ascii")


PAGES = """VERSION ""
BU_: A
BO_ 1 Pages: 2 A
 SG_ page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ first m0 : 8|8@1+ (1,0) [0|0] "" A
 SG_ second m1 : 8|8@1+ (1,0) [0|0] "" A
"""
LINE = r"rig\.dbc, line {}: "
BAD = {
    "huge signal": (DBC.replace("voltage : 0|16", "voltage : 0|99999999"), LINE.format(9) + ".*more than any frame"),
    "huge message": (DBC.replace("Status: 2", "Status: 99999999"), LINE.format(11) + ".*more than any frame"),
    "huge number": (DBC.replace("Status: 2", "Status: " + "9" * 6000), LINE.format(11) + ".*more than any frame"),
    "no message": ('VERSION ""\n', "defines no messages"),
    "empty": ("  \n", "is empty"),
    "not a database": ("time,angle\n0,1\n", LINE.format(1) + "cannot be read"),
    "selections": (DBC + "SG_MUL_VAL_ 102 status angle 0-4000000000;\n", LINE.format(27) + ".*too many multiplexer"),
    "long range": (DBC + "SG_MUL_VAL_ 102 status angle 900000000000-9000000000000;\n", "too many multiplexer"),
    "hidden": (DBC.replace(" SG_ voltage : 0|16", ' SG_ //"\n voltage : 0|99999999'), LINE.format(9) + ".*more than"),
    "nested": (DBC + "".join(f"SG_MUL_VAL_ 102 s{n + 1} s{n} 0-9, 20-29;\n" for n in range(30)), "too many combin"),
    "loop": (DBC + "SG_MUL_VAL_ 102 a b 0-1;\nSG_MUL_VAL_ 102 b a 0-1;\n", "too many combinations"),
}


LENIENT = {
    "syntax": (
        DBC.replace("@1- (0.1,0)", "@1 (0.1,0)"),
        "torque",
        "signal State.angle is left out: it is not written as",
    ),
    "no receiver": (DBC.replace('"rad" B', '"rad"'), "torque", "signal State.angle is left out: it is not written as"),
    "a short header": (
        DBC.replace("BO_ 102 Status: 2 A", "BO_ 102 Status 2 A"),
        "angle Command.status",
        "Status is left out: cannot be",
    ),
    "no end": (DBC.replace("100 10;", "100 10"), "angle", 'GenMsgCycleTime" BO_ 100 10, is left out: it does not end'),
    "no definition": (DBC + 'BA_ "Other" BO_ 100 1;\n', "angle", "the attribute Other is not defined"),
    "no such message": (
        DBC + 'VAL_ 999 x 0 "a" ;\n',
        "angle",
        'VAL_ 999 x 0 "a" ;, is left out: there is no such signal',
    ),
    "standard": (
        DBC.replace("BO_ 102 ", "BO_ 4919 "),
        "angle",
        "Status is left out: its identifier 0x1337 has more than 11",
    ),
    "negative": (DBC.replace("BO_ 102 ", "BO_ -5 "), "angle", "Status is left out: its identifier 0x7FFFFFFB has more"),
    "with a sign": (DBC.replace("_ 102 ", f"_ {0x80000102 - (1 << 32)} "), "angle Status.status", ""),
    "bad pages": (
        PAGES + "SG_MUL_VAL_ 1 first page 0-0\n" + DBC[DBC.index("BO_ 100") :],
        "angle",
        "Pages is left out: it does not end",
    ),
    "float": (DBC + "SIG_VALTYPE_ 100 angle 1\n", "voltage", "message State is left out: the file ends within it"),
    "spaces": (
        DBC + "SG_MUL_VAL_ 102 a b" + " " * 200_000 + "x",
        "angle",
        "message Status is left out: the file ends within it",
    ),
    "words": (DBC + "SG_ " * 100_000, "angle", "the file ends within the name of a message or signal"),
    "quotes": (DBC + '"' * 100_001, "angle", "is left out: the file ends within it"),
    "overlap": (DBC.replace("angle : 0|16", "angle : 0|24"), "angle torque alive_counter crc", ""),
    "too long": (
        DBC.replace("voltage : 0|16", "voltage : 50|16"),
        "angle torque",
        "Command.voltage is left out: it does not lie",
    ),
    "endless scale": (
        DBC.replace("(0.001,0)", "(1e999,0)"),
        "angle",
        "voltage is left out: its scale or offset is not finite",
    ),
    "one identifier": (
        PAGES + "BO_ 1 Other: 1 A\n",
        "first second",
        "Other is left out: it has the identifier 0x1 of Pages",
    ),
    "one name": (DBC.replace("102 Status", "102 State"), "State_66.status", "0x66 is called State_66 here"),
    "twice": (
        PAGES.replace("m1 : 8|8", "m1 : 8|4").replace("second", "first"),
        "page",
        "first is left out: it is there twice",
    ),
    "on two pages": (PAGES.replace("second", "first"), "page first", ""),
    "no such signal": (
        DBC.replace('100 "crc"', '100 "sum"'),
        "angle",
        "counter and checksum are not checked, has no signal 'sum'",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", LENIENT)
def test_what_is_sound_in_a_database_is_used_and_what_is_not_is_told(tmp_path: Path, case: str) -> None:
    text, signals, note = LENIENT[case]
    read = database.load(file(tmp_path, text))
    assert [read.signal(name) for name in signals.split()]
    assert note in "\n".join(read.notes) and bool(note) == bool(read.notes)


def test_values_of_a_wrong_kind_cost_no_more_than_what_they_are_of(tmp_path: Path) -> None:
    text = DBC.replace('"GenMsgCycleTime" INT 0 65535', '"GenMsgCycleTime" STRING').replace(
        "BO_ 100 10;", 'BO_ 100 "x";'
    )
    assert database.load(file(tmp_path, text)).message("State").cycle is None
    nameless = KCD.replace("</Bus>", '<Message id="0x11"><Signal offset="0" length="8"/></Message></Bus>')
    read = database.load(file(tmp_path, nameless, ".kcd"))
    assert (
        read.signal("angle") and "is left out: it is not defined as a message is (a name is missing)" in read.notes[0]
    )


def test_a_signal_that_is_wanted_and_not_sound_is_refused_with_the_reason(tmp_path: Path) -> None:
    read = database.load(file(tmp_path, PAGES + 'BO_ 1 Other: 1 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\n'))
    for name in ("x", "Other.x"):
        with pytest.raises(
            DatabaseError, match=r"in message Other, which is left out: it has the identifier 0x1 of Pages"
        ):
            read.signal(name)
    read = database.load(file(tmp_path, LENIENT["too long"][0]))
    for name in ("voltage", "Command.voltage"):
        with pytest.raises(DatabaseError, match="is left out: it does not lie in the 8 bytes"):
            read.signal(name)


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_its_place(tmp_path: Path, case: str) -> None:
    text, problem = BAD[case]
    begun = process_time()
    with pytest.raises(DatabaseError, match=problem):
        database.load(file(tmp_path, text))
    assert process_time() - begun < 60  # not for ever, nor growing with the square of the file


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + KCD.split("?>")[1], "line 1: declares a document type"),
        (KCD.replace('length="16"', 'length="999999999"'), "line 4: .*more than any frame"),
        (KCD.replace("</Bus>", ""), "line 5: cannot be read at column"),
        (KCD.replace("NetworkDefinition", "Other"), "expected"),
    ],
)
def test_bad_xml_is_refused_with_its_place(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(DatabaseError, match=rf"(?i){problem}"):
        database.load(file(tmp_path, text, ".kcd"))


def test_what_is_no_file_of_a_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.dbc").mkdir()
    for name, problem in [("a.dbc", "no such file"), ("folder.dbc", "is a folder"), ("a.txt", "no format of a CAN")]:
        with pytest.raises(DatabaseError, match=problem):
            database.load(tmp_path / name)
    with (tmp_path / "large.dbc").open("wb") as large:
        large.truncate(100 << 20)
    with pytest.raises(DatabaseError, match="is larger than 32 MiB"):
        database.load(tmp_path / "large.dbc")


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(DBC) - 1), st.integers(0, 40), st.text('0123456789 |@+-()[],:;"\nSG_BOM', max_size=12))
def test_a_damaged_file_is_read_or_refused_but_never_crashes(tmp_path: Path, at: int, cut: int, put: str) -> None:
    path = file(tmp_path, DBC[:at] + put + DBC[at + cut :])
    try:
        database.load(path)
    except DatabaseError as error:
        assert str(path) in str(error)


def test_a_signal_that_is_no_number_is_left_out(tmp_path: Path) -> None:
    message = Message(1, "Long", 16, [Signal("name", 0, 72), Signal("value", 72, 8)])
    path = tmp_path / "long.dbc"
    cantools.database.dump_file(cantools.database.can.Database([message]), str(path))
    read = database.load(path).message("Long")
    assert read.left_out == {"name": "it has 72 bits"}
    assert [signal.name for signal in read.signals] == ["value"]
