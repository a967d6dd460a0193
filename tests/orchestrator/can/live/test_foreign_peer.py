"""500 random signals over a bus to python-can and cantools, and back from them."""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path

import can
import cantools
import pytest
from can.interfaces.slcan import slcanBus
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion

from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database import database
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.slcan.hub import hub_process
from orchestrator.can.statistics import FrameStatistics
from tests.support.can.random_databases import written
from tests.support.can.wiring import HANG, joined

pytestmark = pytest.mark.slow  # processes

COUNT, SEED = 500, 1


def random_signals(draws: random.Random, count: int) -> Database:
    """So many signals in messages of one to eight bytes, of either byte order."""
    messages, left = list[Message](), count
    while left > 0:
        name, length, big = f"M{len(messages)}", draws.randint(1, 8), draws.random() < 0.5
        signals, bit = list[Signal](), draws.randint(0, 4)
        while bit < 8 * length and len(signals) < min(left, 5):
            size = min(draws.choice([1, 2, 5, 8, 12, 16, 32, 64]), 8 * length - bit)
            is_float = size in (32, 64) and draws.random() < 0.5
            scale, offset = draws.choice([1, 0.5, 0.001, -0.02, 10]), draws.choice([0, 0, -40, 0.25])
            conversion = BaseConversion.factory(scale, offset, is_float=is_float)
            start = 8 * (bit // 8) + 7 - bit % 8 if big else bit
            order = "big_endian" if big else "little_endian"
            signed = not is_float and draws.random() < 0.5
            signals.append(Signal(f"{name}_{len(signals)}", start, size, order, signed, conversion=conversion))  # type: ignore[arg-type]
            bit += size + draws.randint(0, 3)
        extended = draws.random() < 0.3
        messages.append(Message(0x100 + len(messages), name, length, signals, is_extended_frame=extended))
        left -= len(signals)
    return Database(messages)


def representable(signal: Signal, draws: random.Random) -> float:
    """A value that the signal can have."""
    if signal.is_float:
        raw = draws.uniform(-1e6, 1e6)
        number = struct.unpack("<f", struct.pack("<f", raw))[0] if signal.length == 32 else raw
    else:
        half, whole = 1 << signal.length - 1, 1 << signal.length
        low, high = (-half, half - 1) if signal.is_signed else (0, whole - 1)
        number = draws.randint(max(low, -(1 << 50)), min(high, 1 << 50))
    return float(number * signal.scale + signal.offset)


def test_500_random_signals_are_the_same_to_a_foreign_peer_both_ways(tmp_path: Path) -> None:
    draws = random.Random(SEED)
    path = written(random_signals(draws, COUNT), tmp_path)
    foreign, ours = cantools.database.load_file(path), database.load(path)
    assert isinstance(foreign, Database)
    statistics, decoder, signals = FrameStatistics(), SingleDecoder(ours), 0
    with hub_process(tmp_path / "bus") as hub, joined(hub.paths[0]) as bus:
        peer = slcanBus(str(hub.paths[1]), bitrate=500_000, sleep_after_open=0.1)
        try:
            for spec in ours.messages:
                theirs = foreign.get_message_by_name(spec.name)
                wanted = {signal.name: representable(signal, draws) for signal in theirs.signals}
                encoder = SingleEncoder(spec, statistics)
                for signal in spec.signals:
                    encoder.set(signal, wanted[signal.name])
                frame = encoder.frame()
                assert frame is not None
                bus.send(frame)
                seen = peer.recv(HANG)
                assert seen is not None and (seen.arbitration_id, seen.is_extended_id) == (spec.id, spec.extended)
                assert_alike(theirs.decode(seen.data, decode_choices=False), wanted, theirs)
                sent = {signal.name: representable(signal, draws) for signal in theirs.signals}
                extended, data = theirs.is_extended_frame, theirs.encode(sent)
                peer.send(can.Message(arbitration_id=theirs.frame_id, is_extended_id=extended, data=data))
                back = bus.recv(HANG)
                assert back is not None
                values = decoder.decode(back)
                assert values is not None
                assert_alike(values, sent, theirs)
                signals += len(spec.signals)
        finally:
            peer.shutdown()
    assert signals == COUNT and not statistics.saturated and decoder.statistics.clean


def assert_alike(found: object, wanted: dict[str, float], message: Message) -> None:
    assert isinstance(found, dict) and found.keys() == wanted.keys()
    for signal in message.signals:
        value, step = wanted[signal.name], 0.0 if signal.is_float else abs(signal.scale)
        assert math.isclose(found[signal.name], value, rel_tol=1e-9, abs_tol=1e-6 * step), (message.name, signal.name)
