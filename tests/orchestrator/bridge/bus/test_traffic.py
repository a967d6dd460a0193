"""What passes over a bus when steps are late or stay away, without any steps."""

from __future__ import annotations

import math
import struct
import time
from fractions import Fraction
from typing import cast

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from orchestrator.bridge.mapping import coupled
from orchestrator.can.database.database import Database
from orchestrator.scenario.can_block import CanBlock
from tests.support.can.coupling_samples import ScriptedBus, frame, sample_system
from tests.support.can.passing import ANY, BLOCK, COMMAND, GUARDED, STEP, on, run, torques

FAULTS = ("", "silent", "checksum", "stuck", "short", "not finite", "hangs")
SPELLS = st.lists(st.tuples(st.sampled_from(FAULTS), st.integers(5, 400)), min_size=1, max_size=8)


def test_safe_values_go_out_at_their_period_while_no_step_ends(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said)
    run(traffic, bus, 0, 100)
    for tick in range(100, 200):
        traffic.watch(tick * STEP)
    sent = torques(bus)
    assert sent == pytest.approx([0.25] * 10 + [0.125] * 5, abs=5e-4)
    counters = [message.data[2] & 15 for message in bus.identified(GUARDED)]
    assert counters == [(k + 1) % 16 for k in range(15)]
    assert said == ["t = 0.151 s: torque rests: no step has ended for 0.051 s"]


def test_frames_from_before_the_beginning_are_as_old_as_they_are(rig: Database) -> None:
    silence, lead = cast(float, BLOCK["silence"]), 0.02
    for age, driven in ((silence - lead, True), (silence + 2 * STEP, False)):
        bus, said = ScriptedBus(), list[str]()
        traffic, begun = on(bus, rig, said, most_late=1e4), time.monotonic()
        bus.waiting.append(frame(COMMAND, struct.pack("<hH", 7000, 0)))
        traffic.listen(begun - age)
        traffic.begin(begun)
        traffic.receive(0.0)
        traffic.send(0, [0.25], 0.0, 0.0)
        assert traffic.inputs[-2] == pytest.approx(7.0 * driven)
        assert torques(bus) == pytest.approx([0.25 if driven else 0.125], abs=5e-4)
        assert said == [] if driven else said[0].startswith("t = 0.000 s: Command: no frame for 0.2 s")
        traffic.receive(lead + STEP)
        traffic.send(10, [0.25], lead + STEP, 0.0)
        assert torques(bus)[-1] == pytest.approx(0.125, abs=5e-4)  # as old as it is from then on, too


def test_of_a_long_time_before_the_beginning_the_latest_frames_are_kept(
    rig: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.bridge.bus.traffic.QUEUE", 10)
    bus = ScriptedBus()
    traffic = on(bus, rig, [])
    for number in range(100):
        bus.waiting.append(frame(COMMAND, struct.pack("<hH", number, 0)))
        traffic.listen(number * STEP)
    traffic.begin(0.1)
    assert traffic.inputs[-2] == pytest.approx(0.099)
    assert traffic.report(0.0).received.messages == {"Command": 10}


def test_frames_that_late_steps_leave_out_are_missing_in_the_counter(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said)
    for number in (0, 10, 20, 70, 80):  # a frame is due at every tenth step
        traffic.receive(number * STEP)
        traffic.send(number, [0.25], number * STEP, 0.0)
    counters = [message.data[2] & 15 for message in bus.identified(GUARDED)]
    assert counters == [1, 2, 3, 8, 9]


def test_frames_of_steps_that_come_together_with_the_end_are_counted_and_the_last_command_is_the_safe_value(
    rig: Database,
) -> None:
    bus = ScriptedBus()
    traffic = on(bus, rig, [])
    run(traffic, bus, 0, 21)
    traffic.pass_over(55)
    traffic.end(0.055)
    report = traffic.report(0.055)
    assert torques(bus) == pytest.approx([0.25] * 3 + [0.125], abs=5e-4)
    assert report.skipped == 3 and report.blocked == 0  # those at 30, 40 and 50
    assert [message.data[2] & 15 for message in bus.identified(GUARDED)] == [1, 2, 3, 7]


def test_late_steps_are_no_burst_of_old_commands_and_go_on_after_good_ones(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said, after=0.02)
    run(traffic, bus, 0, 100)
    run(traffic, bus, 100, 1000, lateness=0.9, real=1e-5)
    assert len(torques(bus)) <= 12 and torques(bus)[10:] == pytest.approx([0.125] * len(torques(bus)[10:]), abs=5e-4)
    run(traffic, bus, 1000, 1100)
    assert torques(bus)[-1] == pytest.approx(0.25)
    assert said[-1] == "t = 1.020 s: torque is sent again"


def test_what_was_about_to_be_sent_when_the_process_was_stopped_is_not_sent_afterwards(rig: Database) -> None:
    bus = ScriptedBus()
    traffic = on(bus, rig, [], most_late=30)
    for number, stood_still in ((0, 0.0), (10, 31.0), (20, 0.0)):
        traffic.begin(time.monotonic() - number * STEP - stood_still)
        run(traffic, bus, number, number + 1)
    assert [message.data[2] & 15 for message in bus.identified(GUARDED)] == [1, 3]
    assert traffic.report(0.02).skipped == 1


def test_an_output_goes_on_after_a_time_of_good_frames_and_not_after_single_ones(rig: Database) -> None:
    """Each of them is good for as long as silence may be, which is longer than `after`."""
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said, after=0.1)
    for number in range(1500):
        if number < 100 or number % 400 < 50 or number >= 1200:
            bus.waiting.append(frame(COMMAND, struct.pack("<hH", number, 0)))
        traffic.receive(number * STEP)
        traffic.send(number, [0.25], number * STEP, 0.0)
    assert [line for line in said if "torque" in line] == [
        "t = 0.300 s: torque rests: without rig.voltage",
        "t = 1.300 s: torque is sent again",
    ]


def test_a_latched_output_stays_at_rest(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said, resume="latch", after=0)
    run(traffic, bus, 0, 100)
    run(traffic, bus, 100, 101, lateness=0.2)
    run(traffic, bus, 101, 400)
    assert set(torques(bus)[10:]) == {0.125}
    assert said == ["t = 0.100 s: torque rests for good: steps are 0.2 s late"]


@pytest.mark.parametrize("resume", ["auto", "latch"])
def test_an_output_runs_from_the_first_step_that_is_in_time_even_where_it_is_latched(
    rig: Database, resume: str
) -> None:
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said, resume=resume)
    bus.waiting.append(frame(COMMAND, struct.pack("<hH", 1, 0)))
    traffic.receive(0.0)
    traffic.send(0, [0.25], 0.06, 0.06)
    run(traffic, bus, 70, 91)
    assert torques(bus) == pytest.approx([0.125, 0.25, 0.25, 0.25], abs=5e-4)
    assert said == []


def test_one_page_or_one_value_that_stays_away_puts_what_needs_it_to_rest(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    receive = {
        "rig.page": {"signal": "first", "safe": 0},
        "rig.voltage": {"signal": "second", "safe": 0},
        "rig.target": {"signal": "target", "safe": 0},
    }
    send = {
        "torque": {"source": "rig.torque", "safe": 0, "while": ["first"]},
        "angle": {"source": "rig.angle", "safe": 0, "while": ["target"]},
    }
    traffic = on(bus, rig, said, receive=receive, send=send, silence=0.1)
    for number in range(400):
        pages = (0, 1) if number < 100 else (1,)
        bus.waiting += [frame(260, struct.pack("<BHxxxxx", page, 7)) for page in pages]
        bus.waiting.append(frame(258, struct.pack("<d", 1.0 if number < 200 else float("nan"))))
        traffic.receive(number * STEP)
        traffic.send(number, [0.25, 0.25], number * STEP, 0.0)
    assert said == [
        "t = 0.200 s: first: no frame for 0.1 s; safe values: rig.page = 0",
        "t = 0.200 s: torque rests: without rig.page",
        "51 values that are not finite",
        "t = 0.300 s: Exact: no good value for 0.1 s (not finite); safe values: rig.target = 0",
        "t = 0.300 s: angle rests: without rig.target",
    ]


def test_values_that_are_limited_rejected_or_not_finite_are_told_while_it_goes_on(rig: Database) -> None:
    bus, said = ScriptedBus(), list[str]()
    changes = {
        "receive": {"rig.target": {"signal": "Exact.target", "safe": 0}},
        "send": {"torque": {"source": "rig.torque", "safe": 0, "limit": {"magnitude": 0.1}}},
    }
    traffic = on(bus, rig, said, ANY, **changes)
    for number in range(20):
        bus.waiting.append(frame(258, struct.pack("<d", math.nan if number % 2 else 9.0)))
        traffic.receive(number * STEP)
        traffic.send(number, [0.25], number * STEP, 0.0)
    traffic.receive(9.0)
    told = " ".join(said)
    assert "values that are not finite" in told and "sent values limited by `limit`" in told


def test_what_an_interface_gives_back_is_no_second_sender_and_not_received(rig: Database) -> None:
    bus = ScriptedBus(lambda sent: [sent])
    traffic = on(bus, rig, [])
    run(traffic, bus, 0, 300)
    assert traffic.report(0.3).foreign == {}
    assert traffic.report(0.3).received.messages == {"Command": 300}
    bus.waiting.append(frame(GUARDED, b"\1\2\3\4"))
    traffic.receive(0.301)
    assert traffic.report(0.3).foreign == {"Guarded": 1}


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spells=SPELLS, latched=st.booleans())
def test_whatever_goes_wrong_no_blind_command_goes_out(
    rig: Database, spells: list[tuple[str, int]], latched: bool
) -> None:
    """Ticks of 1 ms; a good frame comes every 10 ms where none of the faults is there."""
    bus, silence, most_late, period = ScriptedBus(), 0.1, 0.05, 0.002
    changes = {
        "receive": {"rig.page": {"signal": "torque", "safe": 0}},
        "send": {"angle": {"source": "rig.angle", "safe": 0}},
        "every": {"State": period},
        "resume": "latch" if latched else "auto",
    }
    traffic = on(bus, rig, [], ANY, **changes | {"silence": silence, "most_late": most_late})
    peers = CanBlock.model_validate({"database": rig.path, "send": {"torque": "rig.torque"}})
    (peer,) = coupled(peers, sample_system(), [rig], Fraction(1, 1000)).sent
    heard = stepped = -math.inf
    for tick, fault in enumerate(fault for fault, ticks in spells for _ in range(ticks)):
        now, good = tick * STEP, True
        if tick % 10 == 0 and fault != "silent":
            message = peer.frame([0.25])
            assert message is not None
            data, good = bytes(message.data), fault not in ("checksum", "stuck", "short")
            data = {"checksum": bytes([data[0] ^ 1]) + data[1:], "stuck": bytes([0, 0, 5, 0]), "short": data[:2]}.get(
                fault, data
            )
            bus.waiting.append(frame(GUARDED, data))
            heard = now if good else heard
        traffic.receive(now)
        before = len(bus.sent)
        if fault == "hangs":
            traffic.watch(now)
        else:
            traffic.send(tick, [math.nan if fault == "not finite" else 1.0], now, 0.0)
            stepped = now
        for message in bus.sent[before:]:
            if struct.unpack_from("<i", message.data)[0] != 0:
                assert fault != "not finite"
                assert now - heard <= silence + 2 * period + 1e-9
                assert now - stepped <= most_late + STEP + 2 * period
    traffic.end(2.0)
    assert struct.unpack_from("<i", bus.sent[-1].data)[0] == 0


SOURCES = ("page", "target", "voltage")  # inputs: of the pages 0 and 1 of one message, and of another
GROUPS = {"angle": ("page", "voltage"), "speed": ("target", "voltage")}  # outputs, and without which inputs they rest
SPELL = st.tuples(
    st.sets(st.sampled_from([*SOURCES, "short pages"])),
    st.sampled_from(["", "late", "hangs", "angle"]),
    st.integers(20, 250),
)


@pytest.mark.slow
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spells=st.lists(SPELL, min_size=1, max_size=5), latched=st.booleans())
@example(spells=[(set(), "", 51), ({"page"}, "", 160), (set(), "", 124), ({"page"}, "", 20)], latched=False)
def test_each_output_rests_by_its_own_inputs_and_steps_whatever_goes_wrong_at_once(
    rig: Database, spells: list[tuple[set[str], str, int]], latched: bool
) -> None:
    """Ticks of 1 ms; good frames come every 10 ms, pages in turn, but for those that are taken away."""
    bus, silence, after, most_late, period, pages = ScriptedBus(), 0.1, 0.1, 0.05, 0.002, 0.02
    signals = dict(zip(SOURCES, ("first", "second", "Command.voltage"), strict=True))
    changes = {
        "receive": {f"rig.{name}": {"signal": signal, "safe": 0} for name, signal in signals.items()},
        "send": {
            output: {"source": f"rig.{output}", "safe": 0, "while": [f"rig.{name}" for name in needs]}
            for output, needs in GROUPS.items()
        },
        "every": {"State": period},
        "resume": "latch" if latched else "auto",
    }
    traffic = on(bus, rig, [], ANY, **changes | {"silence": silence, "most_late": most_late})
    heard, stepped, behind = dict.fromkeys(SOURCES, -math.inf), 0.0, False
    first = dict(heard)  # of the good frames since the last silence
    bad, ran, fell = dict.fromkeys(GROUPS, 0.0), dict.fromkeys(GROUPS, False), dict.fromkeys(GROUPS, False)
    begun: list[tuple[set[str], str, int]] = [(set(), "", 30)]
    whole = ((gone, steps) for gone, steps, ticks in begun + spells for _ in range(ticks))
    for tick, (gone, steps) in enumerate(whole):
        now, last = tick * STEP, dict(heard)
        if tick % 10 == 0:
            page = tick // 10 % 2
            if SOURCES[page] not in gone:
                bus.waiting.append(frame(260, struct.pack("<BHxxxxx", page, 5)[: 2 if "short pages" in gone else 8]))
                heard[SOURCES[page]] = heard[SOURCES[page]] if "short pages" in gone else now
            if "voltage" not in gone:
                bus.waiting.append(frame(257, struct.pack("<hH", 500, 0)))
                heard["voltage"] = now
        first = {name: now if heard[name] - last[name] > silence + 1e-9 else first[name] for name in SOURCES}
        traffic.receive(now)
        before = len(bus.sent)
        if steps == "hangs":
            traffic.watch(now)
        else:
            traffic.send(tick, [math.nan if steps == "angle" else 1.0, 1.0], now, 0.1 * (steps == "late"))
            stepped, behind = now, steps == "late"
        for output, needs in GROUPS.items():
            late = behind or now - stepped > STEP + most_late  # no step is no proof that they come in time again
            if late or (steps == output) or any(now - heard[name] > silence for name in needs):
                bad[output], fell[output] = now, fell[output] or ran[output]
        for message in bus.sent[before:]:
            values = dict(zip(GROUPS, struct.unpack_from("<ih", message.data), strict=True))
            for output, needs in GROUPS.items():
                ran[output] = ran[output] or values[output] != 0
                good = now - bad[output]
                if values[output]:
                    assert all(now - heard[name] <= silence + 2 * period + 1e-9 for name in needs)
                    assert not fell[output] or (good >= after - 2 * period and not latched)
                    assert not fell[output] or all(heard[name] - first[name] >= after - 1e-9 for name in needs)
                elif all(math.isfinite(heard[name]) for name in needs):
                    unproven = any(heard[name] - first[name] < after + 1e-9 for name in needs)
                    assert good <= after + pages + 2 * period + 1e-9 or (fell[output] and (latched or unproven))
    traffic.end(9.0)
    assert struct.unpack_from("<ih", bus.sent[-1].data) == (0, 0)
