"""Nodes that exchange signals: a database says how these lie in frames, and units and frames have to agree with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError
from fmus.packaging import archive
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.database import load
from orchestrator.engine import Result
from orchestrator.scenario.run import run_scenario
from tests.support.fmus import clocks

Run = Callable[..., Result]
DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 100 Beat: 2 A
 SG_ stamp : 0|16@1+ (0.001,0) [0|60] "" B

BO_ 101 Other: 2 B
 SG_ elsewhere : 0|16@1+ (1,0) [0|0] "" A
"""
SENT = ("out", {"stamp": "last_time"})
RECEIVED = ("trigger", {"stamp": "w"})


def terminals(frame: str, clock: str, signals: dict[str, str]) -> bytes:
    members = "".join(
        f'<TerminalMemberVariable variableKind="signal" variableName="{variable}" memberName="{name}"/>'
        for name, variable in signals.items()
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>
<Terminal name="Line" terminalKind="org.fmi-ls-bus.network-terminal" matchingRule="bus">
  <Terminal name="{frame}" terminalKind="org.fmi-ls-bus.frame-terminal" matchingRule="bus">
    <TerminalMemberVariable variableKind="signal" variableName="{clock}"/>
    <Terminal name="{frame}" terminalKind="org.fmi-ls-bus.pdu-terminal" matchingRule="bus">{members}</Terminal>
  </Terminal>
</Terminal></Terminals></fmiTerminalsAndIcons>""".encode()


@pytest.fixture
def high_cut(tmp_path: Path) -> Callable[..., Path]:
    """What builds an FMU of clocks with a terminal, whose one frame has this clock and these signals."""

    def build(
        name: str, own: tuple[str, ...], frame: tuple[str, dict[str, str]], called: str = "Beat", **more: Any
    ) -> Path:
        path = clocks.build(tmp_path, own, name=name)
        files = archive.read(path)
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(called, *frame)
        if brought := more.get("database"):
            files["extra/org.fmi-standard.fmi-ls-bus/Line.dbc"] = brought.encode()
        archive.write(path, files)
        return path

    return build


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "line.dbc"
    path.write_text(DBC)
    return path


def bus(**more: Any) -> dict[str, Any]:
    return {"line": {"nodes": ["a.Line", "b.Line"], "bitrate": 500_000} | more}


def test_signals_go_in_frames_when_their_clock_ticks(high_cut: Any, run: Run, database: Path) -> None:
    parts = {"a": (high_cut("a", ("tick", "out"), SENT), {}), "b": (high_cut("b", ("trigger",), RECEIVED), {})}
    found = run(parts, bus(database=str(database)), step=0.05)
    frames = list(found.carried["line"].frames.messages())
    assert [round(frame.timestamp, 3) for frame in frames] == [0.2, 0.5, 0.8]
    decoder = SingleDecoder(load(database))
    values = [decoder.decode(frame) for frame in frames]
    assert [one and one["stamp"] for one in values] == pytest.approx([0.2, 0.5, 0.8], abs=5e-4)
    heard = found.trace["b.heard"]
    assert np.unique(heard).tolist() == pytest.approx([0.0, 0.2, 0.5, 0.8], abs=5e-4)
    assert found.trace["b.n_trigger"][-1] == 3
    assert found.trace["b.n_trigger"].tolist().index(1) == 6  # received at 0.25, in the step that ends at 0.3


def test_the_database_that_an_fmu_brings_along_is_taken(high_cut: Any, run: Run) -> None:
    parts = {
        "a": (high_cut("a", ("tick", "out"), SENT, database=DBC), {}),
        "b": (high_cut("b", ("trigger",), RECEIVED, database=DBC), {}),
    }
    assert run(parts, bus(), step=0.05).trace["b.n_trigger"][-1] == 3


@pytest.mark.parametrize(
    ("sent", "called", "brought", "given", "why"),
    [
        (SENT, "Beat", "", False, r"exchanges signals, and brings no Line\.dbc .*give the bus a `database`"),
        (SENT, "Bet", "", True, r"has no message 'Bet'; did you mean 'Beat'"),
        (("out", {}), "Beat", "", True, r"Beat\.stamp: is not in its terminal"),
        (("out", {**SENT[1], "more": "gauge"}), "Beat", "", True, r"Beat\.more: is not in .*line\.dbc"),
        (("out", {"stamp": "u"}), "Beat", "", True, r"Beat\.stamp: is Float64, input, not an output"),
        (("gauge", SENT[1]), "Beat", "", True, r"Beat: has 0 clocks, and a frame has one"),
        (
            SENT,
            "Beat",
            DBC.replace("0|16@1+ (0.001", "0|15@1+ (0.001"),
            True,
            r"Beat: lies otherwise in .*than in the FMU's own",
        ),
    ],
)
def test_a_terminal_that_does_not_fit_the_database_names_the_place(
    high_cut: Any, run: Run, database: Path, sent: Any, called: str, brought: str, given: bool, why: str
) -> None:
    parts = {
        "a": (high_cut("a", ("tick", "out"), sent, called, database=brought), {}),
        "b": (high_cut("b", ("trigger",), RECEIVED), {}),
    }
    with pytest.raises(InputError, match=why):
        run(parts, bus(**({"database": str(database)} if given else {})), step=0.05)


def test_a_direct_wire_carries_no_signals(high_cut: Any, run: Run) -> None:
    parts = {
        "a": (high_cut("a", ("tick", "out"), SENT, database=DBC), {}),
        "b": (high_cut("b", ("trigger",), RECEIVED, database=DBC), {}),
    }
    with pytest.raises(InputError, match=r"a\.Line: exchanges signals, which a direct wire does not carry"):
        run(parts, {"w": {"nodes": ["a.Line", "b.Line"], "direct": True}}, step=0.05)


PAGED = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 100 Beat: 4 A
 SG_ page M : 0|8@1+ (1,0) [0|60] "" B
 SG_ stamp m3 : 8|16@1+ (0.001,0) [0|60] "" B
"""


@pytest.fixture
def paged(high_cut: Any, tmp_path: Path) -> dict[str, Any]:
    """The number of ticks selects the page, and 6 and 9 select none: those frames are not sent, which is told."""
    (tmp_path / "paged.dbc").write_text(PAGED)
    sent = ("out", {"page": "n_tick", "stamp": "last_time"})
    received = ("trigger", {"page": "u", "stamp": "w"})
    return {"a": (high_cut("a", ("tick", "out"), sent), {}), "b": (high_cut("b", ("trigger",), received), {})}


def test_every_run_begins_with_nothing_sent_or_received(paged: Any, scenario: Any, tmp_path: Path) -> None:
    cases = {"cases": [{"name": "one"}, {"name": "other"}]}
    file = scenario(paged, bus(database=str(tmp_path / "paged.dbc")), step=0.05, more=cases)
    one, other = (case.result for case in run_scenario(file).cases)
    assert one is not None and other is not None
    assert one.carried["line"].remarks == other.carried["line"].remarks
    assert one.trace == other.trace


def test_a_multiplexed_frame_sets_what_its_page_has(paged: Any, run: Run, tmp_path: Path) -> None:
    found = run(paged, bus(database=str(tmp_path / "paged.dbc")), step=0.05)
    frames = list(found.carried["line"].frames.messages())
    assert [(round(frame.timestamp, 3), frame.data[0]) for frame in frames] == [(0.2, 3)]
    assert found.trace["b.n_trigger"][-1] == 1
    assert np.unique(found.trace["b.heard"]).tolist() == pytest.approx([0.0, 0.2], abs=5e-4)
    assert found.carried["line"].remarks == ("a.Line: frames with an unknown multiplexer value: Beat 2",)
