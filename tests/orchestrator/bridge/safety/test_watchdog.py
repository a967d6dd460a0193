"""The watchdog: safe values in time, never twice said, and a count of all of it."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.bridge.mapping import coupled
from orchestrator.bridge.safety.watchdog import MOST, SAID, PeerPresence, Watchdog
from orchestrator.bridge.signals.inputs import ReceivedMessage, TakenFrame
from orchestrator.scenario.can_block import CanBlock
from orchestrator.trace import FloatArray
from tests.support.can.coupling_samples import sample_database, sample_system

SILENCE = 0.1
VOLTAGE, TARGET = 5, 4  # places of these inputs
RECEIVE = {
    "rig.voltage": {"signal": "Command.voltage", "safe": 1.5, "silence": SILENCE},
    "rig.target": {"signal": "target", "safe": -2.0, "silence": 10.0},
}


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> tuple[ReceivedMessage, ...]:
    return received(tmp_path_factory.mktemp("database"))


def received(folder: Path) -> tuple[ReceivedMessage, ...]:
    """Command and Exact, which are received."""
    rig = sample_database(folder)
    block = CanBlock.model_validate({"database": rig.path, "receive": RECEIVE})
    return coupled(block, sample_system(), [rig], Fraction(1, 1000)).reception.messages


def driven() -> FloatArray:
    """Inputs that peers have set."""
    return np.full(6, 9.0)


def heard(watchdog: Watchdog, message: ReceivedMessage, now: float) -> None:
    """A good frame."""
    watchdog.took(TakenFrame(message, message.signals, {}), now)


def command(watchdog: Watchdog, now: float) -> PeerPresence:
    return watchdog.report(now).messages["Command"]


def test_a_message_that_stays_away_puts_its_inputs_to_their_safe_values(messages: tuple[ReceivedMessage, ...]) -> None:
    said: list[str] = []
    watchdog, values = Watchdog(messages, said.append), driven()
    heard(watchdog, messages[0], 0.5)
    watchdog.check(0.5 + SILENCE, values)
    assert values[VOLTAGE] == 9.0 and said == []
    watchdog.check(0.6001, values)
    assert values[VOLTAGE] == 1.5 and values[TARGET] == 9.0
    assert said == ["t = 0.600 s: Command: no frame for 0.1 s; safe values: rig.voltage = 1.5"]


def test_a_message_that_never_comes_is_silent_from_the_start(messages: tuple[ReceivedMessage, ...]) -> None:
    said: list[str] = []
    watchdog, values = Watchdog(messages, said.append), driven()
    for k in range(300):
        watchdog.check(0.001 * k, values)
    assert len(said) == 1 and command(watchdog, 0.3).silences == 1
    assert command(watchdog, 0.3) == PeerPresence(0, None, SILENCE, 1, 0.3, {"rig.voltage": 1.5})


def test_frames_that_come_back_end_the_silence_and_that_is_said(messages: tuple[ReceivedMessage, ...]) -> None:
    said: list[str] = []
    watchdog, values = Watchdog(messages, said.append), driven()
    heard(watchdog, messages[0], 0.02)
    watchdog.check(0.2, values)
    heard(watchdog, messages[0], 0.5)
    watchdog.check(0.55, values)
    assert said[1:] == ["t = 0.500 s: Command is back"]
    assert [(event.time, event.kind) for event in watchdog.events] == [(0.02, "first"), (0.2, "silent"), (0.5, "back")]
    assert command(watchdog, 0.6).at_safe_values == pytest.approx(0.02 + 0.3)
    assert command(watchdog, 0.6).frames == 2


def test_a_lost_bus_takes_all_inputs_at_once_and_says_why(messages: tuple[ReceivedMessage, ...]) -> None:
    said: list[str] = []
    watchdog, values = Watchdog(messages, said.append), driven()
    heard(watchdog, messages[0], 0.3)
    heard(watchdog, messages[1], 0.3)
    watchdog.lost(0.31, "unplugged", values)
    watchdog.lost(0.32, "unplugged", values)
    assert (values[VOLTAGE], values[TARGET]) == (1.5, -2.0)
    assert said == [
        "t = 0.310 s: Command: unplugged; safe values: rig.voltage = 1.5",
        "t = 0.310 s: Exact: unplugged; safe values: rig.target = -2",
    ]


def test_a_peer_that_comes_and_goes_fills_neither_memory_nor_log(
    messages: tuple[ReceivedMessage, ...],
) -> None:
    said: list[str] = []
    watchdog, values = Watchdog(messages[:1], said.append), driven()
    for k in range(2 * MOST):
        heard(watchdog, messages[0], k)
        watchdog.check(k + 0.5, values)
    assert watchdog.event_count == 4 * MOST
    assert len(watchdog.events) == MOST and len(said) <= SAID + 1
    assert command(watchdog, 0).silences == 2 * MOST


@settings(max_examples=50)
@given(gaps=st.lists(st.floats(0.001, 0.5), min_size=1, max_size=20))
def test_inputs_have_safe_values_exactly_while_the_silence_is_longer_than_allowed(
    messages: tuple[ReceivedMessage, ...], gaps: list[float]
) -> None:
    watchdog, values, now, silences = Watchdog(messages[:1], lambda line: None), driven(), 0.0, 0
    heard(watchdog, messages[0], 0.0)
    for gap in gaps:
        values[VOLTAGE] = 9.0
        watchdog.check(now + gap, values)
        silent = now + gap - now > SILENCE
        silences += silent
        assert values[VOLTAGE] == (1.5 if silent else 9.0)
        now += gap
        heard(watchdog, messages[0], now)
    assert command(watchdog, now).silences == silences
