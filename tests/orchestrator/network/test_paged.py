"""Network FMUs with multiplexed messages, and with those of J1939: frame for frame what the codec of logs writes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave, fmi3Binary

from fmus.errors import DatabaseError
from fmus.modelling import ops
from fmus.modelling.model import Model, Variable, input_, output
from fmus.packaging import targets
from fmus.packaging.native import compiler
from orchestrator.can.codec.message_writer import MessageWriter
from orchestrator.can.database.database import load
from orchestrator.can.ls_bus.operations import Transmit, decoded, encoded
from orchestrator.can.statistics import FrameStatistics
from orchestrator.engine import Result
from orchestrator.network.export import exported

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not compiler.available(), reason="there is no C compiler")]
Run = Callable[..., Result]

TAIL = """
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 100000;
BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_DEF_DEF_ "ChecksumSignal" "";
"""
PAGED = (
    """VERSION ""
BU_: One Other
BO_ 256 Pages: 8 One
 SG_ page M : 4|4@1+ (1,0) [0|15] "" Other
 SG_ alive_counter : 0|4@1+ (1,0) [0|15] "" Other
 SG_ a m0 : 8|16@1- (0.01,0) [0|0] "V" Other
 SG_ spare m0 : 24|8@1+ (1,0) [0|255] "" Other
 SG_ b m1 : 23|16@0- (0.01,-2) [0|0] "V" Other
 SG_ nobody m3 : 8|8@1+ (1,0) [0|255] "" Other
 SG_ c m5 : 8|32@1- (1,0) [0|0] "V" Other
 SG_ always : 40|8@1+ (1,0) [0|255] "" Other
 SG_ check : 56|8@1+ (1,0) [0|255] "" Other

BO_ 257 Chosen: 8 One
 SG_ mode M : 0|8@1+ (1,0) [0|15] "" Other
 SG_ d m0 : 8|16@1- (0.01,0) [0|0] "V" Other
 SG_ e m1 : 8|8@1- (1,0) [0|0] "V" Other
 SG_ low m1 : 16|8@1- (1,0) [-100|0] "" Other
 SG_ half m2 : 8|32@1- (2,0) [0|0] "" Other

BO_ 258 Nested: 8 One
 SG_ outer M : 0|8@1+ (1,0) [0|15] "" Other
 SG_ inner m1M : 8|8@1+ (1,0) [0|15] "" Other
 SG_ f m4 : 16|16@1- (0.01,0) [0|0] "V" Other
 SG_ g m2 : 16|16@1- (0.01,0) [0|0] "V" Other
"""
    + TAIL
    + """BA_ "GenSigStartValue" SG_ 256 spare 9;
BA_ "GenSigStartValue" SG_ 256 always 3;
BA_ "GenSigStartValue" SG_ 257 low -5;
BA_ "GenSigStartValue" SG_ 257 half 11;
BA_ "ChecksumSignal" BO_ 256 "check";
SIG_VALTYPE_ 256 c : 1;
SIG_VALTYPE_ 257 half : 1;
SG_MUL_VAL_ 258 inner outer 1-1;
SG_MUL_VAL_ 258 f inner 4-4, 6-7;
SG_MUL_VAL_ 258 g outer 2-3;
"""
)
NAMES = ("a", "b", "c", "d", "e", "f", "g", "mode")
SLOPES = {"a": 3.0, "b": -5.0, "c": 0.125, "d": 7.0, "e": 100.0, "f": 2.0, "g": 11.0}


def giver() -> Model:
    """Ramps, and a mode that goes round."""

    def outputs(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        count = ops.floor(t * 100 + 0.5)
        ramps = {name: slope * count * 0.01 for name, slope in SLOPES.items()}
        return {**ramps, "mode": count - 4 * ops.floor(count / 4)}

    units = dict.fromkeys(NAMES, "V") | {"mode": "1"}
    return Model("giver", "Ramps", tuple(output(name, units[name], "Ramp") for name in NAMES), outputs=outputs)


def taker() -> Model:
    names = [name for name in NAMES if name != "mode"]
    return Model(
        name="taker",
        description="Values as they come",
        variables=(
            *(input_(name, "V", "Received", -77.0) for name in names),
            *(output(f"got_{name}", "V", "The same") for name in names),
        ),
        outputs=lambda t, x, u, p: {f"got_{name}": getattr(u, name) for name in names},
    )


def written(model: Model, text: str, folder: Path) -> Path:
    (folder / "lines.dbc").write_text(text)
    network = exported(model, folder / "lines.dbc").network
    return targets.build(model, folder / f"{model.name}.fmu", target="native", fmi=3, network=network)


@pytest.fixture
def carried(tmp_path: Path, run: Run) -> Result:
    parts: dict[str, Any] = {"g": (written(giver(), PAGED, tmp_path), {}), "t": (written(taker(), PAGED, tmp_path), {})}
    return run(parts, {"can0": {"nodes": ["g.lines", "t.lines"], "bitrate": 1_000_000}}, step=0.01)


def test_its_frames_are_those_that_the_codec_writes(carried: Result, tmp_path: Path) -> None:
    frames, database = carried.carried["can0"].frames, load(tmp_path / "lines.dbc")
    for identifier, name in ((256, "Pages"), (257, "Chosen"), (258, "Nested")):
        message, own = database.message(name), frames.id == identifier
        count = int(np.count_nonzero(own))
        due = np.arange(count) * 0.01
        steps = np.floor(due * 100 + 0.5)
        columns = {one: slope * steps * 0.01 for one, slope in SLOPES.items()} | {"mode": steps % 4}
        sent = {signal.name: signal.name for signal in message.signals if signal.name in NAMES}
        expected = MessageWriter(message, sent, FrameStatistics()).write(due, columns)
        assert count in (99, 100)  # that of the end may be on its way
        assert frames.data[own].tolist() == expected.data[:, : frames.data.shape[1]].tolist(), name


def test_each_page_sets_what_is_on_it(carried: Result) -> None:
    trace = carried.trace
    turns = {"a": (3, 0), "c": (3, 1), "b": (3, 2), "d": (4, 0), "e": (4, 1), "f": (2, 0), "g": (2, 1)}
    for name, (every, page) in turns.items():  # pages in the order in which their signals lie in the frame
        got, steps = trace[f"t.got_{name}"], np.arange(len(trace))
        sent = np.where(steps - 2 >= page, (steps - 2 - page) // every * every + page, -1)
        expected = np.where(sent >= 0, SLOPES[name] * sent * 0.01, -77.0)
        limited = np.clip(expected, -77, 127) if name == "e" else expected
        assert got == pytest.approx(limited, abs=0.51 if name == "e" else 0.0051), name


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("mode M : 0|8@1+ (1,0)", "mode M : 0|8@1+ (3,0)"), r"Chosen\.e: is selected by mode, which cannot have its"),
        (("SG_ c m5 : 8|32@1-", "SG_ c m0 : 8|32@1-"), r"Pages: cannot be sent: .*overlap"),
    ],
)
def test_what_cannot_be_selected_names_the_place(tmp_path: Path, change: tuple[str, str], why: str) -> None:
    assert change[0] in PAGED
    (tmp_path / "lines.dbc").write_text(PAGED.replace(*change))
    with pytest.raises(DatabaseError, match=why):
        exported(giver(), tmp_path / "lines.dbc")


def test_a_multiplexer_that_nobody_sets_in_frames_that_the_model_selects_is_refused(tmp_path: Path) -> None:
    (tmp_path / "lines.dbc").write_text(PAGED)
    model = Model(
        name="half",
        description="Gives the outer multiplexer alone",
        variables=(output("outer", "1", "Outer"), output("f", "V", "Inner value"), input_("x", "1", "In")),
        outputs=lambda t, x, u, p: {"outer": u.x, "f": u.x},
    )
    with pytest.raises(DatabaseError, match=r"Nested\.inner: is in frames that outer selects, .*; give the"):
        exported(model, tmp_path / "lines.dbc")


GROUP = (
    """VERSION ""
BU_: One Other
BO_ 2566844705 Speed: 8 One
 SG_ a : 0|16@1- (0.01,0) [0|0] "V" Other
BO_ 2566845182 Load: 8 One
 SG_ b : 0|16@1- (0.01,0) [0|0] "V" Other
BO_ 2565867793 Left: 8 One
 SG_ c : 0|16@1- (0.01,0) [0|0] "V" Other
BO_ 2565867794 Right: 8 One
 SG_ d : 0|16@1- (0.01,0) [0|0] "V" Other
"""
    + TAIL.replace('BA_DEF_ BO_ "Gen', 'BA_DEF_ "ProtocolType" STRING;\nBA_DEF_ BO_ "Gen')
    + ('BA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n')
)


def gauge(*names: str, sent: bool = False) -> Model:
    if sent:
        return Model(
            name="gauge",
            description="Gives one",
            variables=tuple(output(name, "V", "One") for name in names),
            outputs=lambda t, x, u, p: dict.fromkeys(names, 1.0 + 0 * t),
        )
    return Model(
        name="gauge",
        description="Takes some",
        variables=tuple(Variable(name, "V", "input", "In", -1.0) for name in names)
        + tuple(output(f"got_{name}", "V", "The same") for name in names),
        outputs=lambda t, x, u, p: {f"got_{name}": getattr(u, name) for name in names},
    )


@contextmanager
def instance(path: Path, folder: Path) -> Iterator[tuple[FMU3Slave, dict[str, int]]]:
    unpacked = fmpy.extract(str(path), str(folder))
    description = fmpy.read_model_description(unpacked)
    fmu = FMU3Slave(
        guid=description.guid,
        unzipDirectory=unpacked,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="g",
    )
    fmu.instantiate(eventModeUsed=True)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    yield fmu, {variable.name: variable.valueReference for variable in description.modelVariables}
    fmu.terminate()
    fmu.freeInstance()


@pytest.mark.parametrize(
    ("identifier", "taken"),
    [
        (0x18FEF121, "a"),
        (0x0CFEF133, "a"),  # the only one of its group: whoever sends it, at whatever priority
        (0x18FEF1FE, "a"),
        (0x18FEF2FE, "b"),
        (0x18FEF205, "b"),
        (0x18F00911, "c"),
        (0x0CF00912, "d"),
        (0x18F00913, ""),  # of a group with two senders, and of neither
        (0x18FEF321, ""),
    ],
)
def test_groups_are_received_as_logs_are_read(tmp_path: Path, identifier: int, taken: str) -> None:
    path = written(gauge("a", "b", "c", "d"), GROUP, tmp_path)
    with instance(path, tmp_path / "unpacked") as (fmu, references):
        data = encoded([Transmit(identifier, True, False, 8, (250).to_bytes(2, "little") + bytes(6))])
        whole = ctypes.create_string_buffer(data, len(data))
        fmu.fmi3SetClock(fmu.component, (ctypes.c_uint * 1)(references["lines.Rx_Clock"]), 1, (ctypes.c_bool * 1)(True))
        sizes, values = (ctypes.c_size_t * 1)(len(whole)), (fmi3Binary * 1)(ctypes.cast(whole, fmi3Binary))
        fmu.fmi3SetBinary(fmu.component, (ctypes.c_uint * 1)(references["lines.Rx_Data"]), 1, sizes, values, 1)
        fmu.updateDiscreteStates()
        got = {name: fmu.getFloat64([references[f"got_{name}"]])[0] for name in "abcd"}
    assert got == dict.fromkeys("abcd", -1.0) | ({taken: 2.5} if taken else {})


def test_a_group_is_sent_with_its_senders_address(tmp_path: Path) -> None:
    path = written(gauge("a", "c", sent=True), GROUP, tmp_path)
    with instance(path, tmp_path / "unpacked") as (fmu, references):
        clock, data = ((ctypes.c_uint * 1)(references[f"lines.Tx_{what}"]) for what in ("Clock", "Data"))
        fmu.fmi3SetClock(fmu.component, clock, 1, (ctypes.c_bool * 1)(True))
        sizes, values = (ctypes.c_size_t * 1)(), (fmi3Binary * 1)()
        fmu.fmi3GetBinary(fmu.component, data, 1, sizes, values, 1)
        sent = decoded(ctypes.string_at(values[0], sizes[0]))
        fmu.updateDiscreteStates()
    assert [(one.id, one.extended) for one in sent if isinstance(one, Transmit)] == [
        (0x18FEF121, True),
        (0x18F00911, True),
    ]


@pytest.mark.parametrize(
    ("names", "change", "why"),
    [
        (("b",), ("", ""), r"Load: has no address of a sender in its identifier; give it that of the model"),
        (("a",), ("Speed: 8", "Speed: 12"), r"Speed: has 12 bytes, which J1939 sends in several frames; take it apart"),
    ],
)
def test_groups_that_cannot_be_sent_are_refused(
    tmp_path: Path, names: tuple[str, ...], change: tuple[str, str], why: str
) -> None:
    (tmp_path / "lines.dbc").write_text(GROUP.replace(*change))
    with pytest.raises(DatabaseError, match=why):
        exported(gauge(*names, sent=True), tmp_path / "lines.dbc")
