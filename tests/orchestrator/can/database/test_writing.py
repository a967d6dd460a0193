"""A generated database holds what was declared: every name, unit, range and rate, in messages that fit a frame."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fmus.errors import DatabaseError
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.fields import raw_limits
from orchestrator.can.database import database
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.writing import Declared, generate, signal_names
from orchestrator.trace import Trace
from tests.support.can.can_samples import by_message

bounds = st.floats(-1e9, 1e9, allow_nan=False).map(lambda value: float(f"{value:.6g}"))


@st.composite
def declarations(draw: st.DrawFn) -> list[Declared]:
    names = draw(st.lists(st.text("abcZ.09 é", min_size=1, max_size=40), min_size=1, max_size=12, unique=True))
    found = []
    for name in names:
        low, high = sorted((draw(bounds), draw(bounds)))
        bounded = draw(st.booleans()) and high > low
        found.append(
            Declared(
                name,
                draw(st.sampled_from(["rad", "N.m", ""])),
                low if bounded else None,
                high if bounded else None,
                draw(st.none() | st.just(1.0)),
                draw(st.sampled_from([None, 0.001, 0.0125, 0.1])),
                draw(st.sampled_from(["", "rig"])),
            )
        )
    return found


def read(declared: list[Declared], fd: bool = False) -> Database:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.dbc"
        generate(declared, path, fd)
        return database.load(path)


@settings(max_examples=60, deadline=None)
@given(declarations(), st.booleans())
def test_reading_a_generated_database_gives_what_was_declared(declared: list[Declared], fd: bool) -> None:
    base, names = read(declared, fd), signal_names([wanted.name for wanted in declared])
    assert len({*names.values()}) == len(declared)
    for wanted in declared:
        message, signal = base.signal(names[wanted.name])
        assert (signal.unit, signal.comment, message.cycle) == (wanted.unit, wanted.name, wanted.every)
        assert message.fd == fd and message.length <= (64 if fd else 8)
        assert message.raw.senders == [wanted.sender or "Servotwin"]
        assert len(signal.name) <= 32 and signal.name.isidentifier() and signal.name.isascii()
        if not signal.is_float:
            assert (signal.minimum, signal.maximum) == (wanted.minimum, wanted.maximum)
    assert sum(len(message.signals) for message in base.messages) == len(declared)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(declarations())
@example([Declared("subnormal", minimum=-5e-324, maximum=0.0)])
@example([Declared("subnormal", minimum=2e-310, maximum=3e-310, nominal=1.0)])
@example([Declared("narrow", minimum=1e-20, maximum=1.0000000001e-20)])
def test_bounds_are_sent_to_within_a_step_and_nominal_values_to_a_thousandth(declared: list[Declared]) -> None:
    base, names = read(declared), signal_names([wanted.name for wanted in declared])
    for wanted in (one for one in declared if one.minimum is not None and one.maximum is not None):
        name = names[wanted.name]
        signal = base.signal(name)[1]
        sent = Encoder(base, [name])
        out = sent.encode(Trace(np.array([0.0, 1.0]), {name: np.array([wanted.minimum, wanted.maximum])}))
        values = by_message(Decoder(LogDatabase(base)).feed(out))[base.signal(name)[0].name].values[name]
        step = 1e-7 * max(abs(wanted.minimum), abs(wanted.maximum)) if signal.is_float else signal.scale
        assert abs(values[0] - wanted.minimum) <= step
        assert abs(values[-1] - wanted.maximum) <= step
        assert signal.is_float or signal.scale == 1e-30 or (wanted.maximum - wanted.minimum) / signal.scale > 65535 / 13
        assert signal.is_float or not wanted.nominal or signal.scale <= wanted.nominal / 1000


def test_faster_messages_have_lower_identifiers_and_are_full_before_the_next_begins() -> None:
    declared = [Declared(f"s{n}", "", -1, 1, every=(0.1, 0.001)[n < 5]) for n in range(7)]
    base = read(declared)
    assert [(message.name, message.id, message.length) for message in base.messages] == [
        ("Servotwin_1ms", 0x100, 8),
        ("Servotwin_1ms_2", 0x101, 2),
        ("Servotwin_100ms", 0x102, 4),
    ]
    assert [len(message.signals) for message in read(declared, fd=True).messages] == [5, 2]


def test_a_signal_far_from_zero_gets_an_offset_and_one_without_bounds_is_a_float() -> None:
    base = read(
        [
            Declared("pressure", "Pa", 1e5, 1.01e5),
            Declared("free", "V", minimum=0),
            Declared("wide", "V", -1e6, 1e6, nominal=1),
            Declared("angle", "rad", -10, 10),
        ]
    )
    pressure, angle = base.signal("pressure")[1], base.signal("angle")[1]
    assert (pressure.scale, pressure.offset, pressure.is_signed, pressure.length) == (0.02, 1e5, False, 16)
    assert (angle.scale, angle.offset, angle.is_signed) == (0.0005, 0, True)
    assert raw_limits(angle) == (-20000, 20000)
    assert base.signal("free")[1].is_float and base.signal("wide")[1].is_float


def test_the_text_is_that_of_cantools_and_stays_the_same() -> None:
    text = generate([Declared("a.b", "V", 0, 24, every=0.01), Declared("c", "A", every=0.0005)])
    raw = cantools.database.load_string(text, "dbc")
    assert raw.as_dbc_string() == text


@pytest.mark.parametrize(
    ("declared", "problem"),
    [
        ([], "0 signals make 0 messages"),
        ([Declared("a"), Declared("a")], "signal a: is declared twice"),
        ([Declared("a", minimum=1, maximum=1)], "ranges from 1 to 1"),
        ([Declared("a", minimum=0, maximum=np.inf)], "has a bound that is not below"),
        ([Declared("a", every=0)], "has a period of 0 s"),
        ([Declared("a", every=np.nan)], "has a bound that is not below"),
        ([Declared(f"s{n}", every=0.001) for n in range(4000)], "4000 signals make 2000 messages"),
    ],
)
def test_a_declaration_that_makes_no_database_is_refused(declared: list[Declared], problem: str) -> None:
    with pytest.raises(DatabaseError, match=problem):
        generate(declared)
