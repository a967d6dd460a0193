"""The frames of a log back onto a bus, each at its own time.

Lateness of one frame does not delay those after it, but where it is held up for longer it goes on where it was.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import can

from fmus.errors import BusError, InputError
from orchestrator.can import logs
from orchestrator.can.database.bus import load_all
from orchestrator.can.database.sources import DatabaseFiles
from orchestrator.can.frames import Frames
from orchestrator.can.live.bus import BusSettings, is_bus_off, send
from orchestrator.can.live.channels import Channel, Channels, listening
from orchestrator.can.live.link import ECHOING, REFUSING
from orchestrator.can.live.news import News
from orchestrator.can.sending.last_frames import LastFrames
from orchestrator.can.sending.passes import ahead, passes
from orchestrator.can.sending.safe_end import NOTHING, Last, SafeEnd
from orchestrator.can.sending.selection import EVERYTHING, MessageSelection, Selection
from orchestrator.can.sending.timetable import Timetable
from orchestrator.can.slcan.flow import Key
from orchestrator.can.statistics import identifier_text
from orchestrator.processes.interrupts import endings, handling
from orchestrator.progress import Progress, silent
from orchestrator.realtime.lateness import Lateness
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests

LOG = logging.getLogger("servotwin.can")
_LEAD = 0.05  # from the start to the first frame [s]
_PERIOD = 0.25  # between two reports of progress, and two looks at what the adapter says [s]
_HEARD = 65536  # frames of others that are kept between two looks at most
_HELD_UP = "ms for which the replay was held up; it goes on where it was"
_REFUSED = 0.2  # for which an adapter may refuse all frames [s]
_ECHO = 0.3  # after the last frame, until the adapter has sent what it keeps and has said what there is to say [s]


@dataclass
class Replayed:
    """What was sent, and how well in time.

    Attributes:
        sent: frames that adapters were given; refused: of these, those that they did not take.
        skipped: error frames, which a bus makes and nobody sends.
        left_out: frames that are not chosen; missing: names of what is chosen and was not in the log.
        homeless: frames of channels for which there is no bus; channels: those that the frames are of; mixed:
            whether they went onto one bus.
        last: frames that were sent last, as `123#00`; dropped: those before that a full bus had no room for by then.
        setbacks: stamps before the one of the frame before; such a frame follows at once, later ones keep their
            distance to it.
        lateness: of the frames.
        pauses: how often it was held up, which moves all later frames; paused: for how long in all [s].
        foreign: messages, as `123`, that somebody else sent, too.
        duration: from the first to the latest frame [s].
        stopped: whether it was told to end before the log did.
        errors: error frames that came from the bus meanwhile.
        damage: places of the log that could not be read.
    """

    KEYS = (
        *("sent=out", "refused", "dropped", "skipped", "left_out", "missing", "homeless", "channels", "last"),
        *("setbacks", "error_frames=errors", "pauses", "paused", "sent_by_others=foreign", "duration", "stopped"),
        *("lateness=lateness.figures", "damage"),
    )

    sent: int = 0
    skipped: int = 0
    setbacks: int = 0
    errors: int = 0
    lateness: Lateness = field(default_factory=Lateness)
    duration: float = 0.0
    stopped: bool = False
    damage: list[str] = field(default_factory=list)
    left_out: int = 0
    missing: list[str] = field(default_factory=list)
    homeless: int = 0
    mixed: bool = False
    channels: set[int] = field(default_factory=set)
    last: list[str] = field(default_factory=list)
    refused: int = 0
    dropped: int = 0
    pauses: int = 0
    paused: float = 0.0
    foreign: list[str] = field(default_factory=list)

    @property
    def out(self) -> int:
        """Frames that were neither refused nor dropped."""
        return self.sent - self.refused - self.dropped

    def lines(self) -> list[str]:
        """For people."""
        late = self.lateness.figures
        told = {
            f"sent last: {', '.join(self.last)}": self.last,
            f"{self.refused:,} frames were not sent: the adapter refused them": self.refused,
            f"{self.dropped:,} frames were not sent: the bus was full at the end": self.dropped,
            f"{self.skipped:,} error frames of the log were not sent": self.skipped,
            f"{self.left_out:,} frames of the log were not chosen": self.left_out,
            f"the log holds no frame of {', '.join(self.missing)}": self.missing,
            f"{self.homeless:,} frames were of channels without a bus, and not sent": self.homeless,
            f"{self.errors:,} error frames came from the bus meanwhile": self.errors,
            f"it was held up {self.pauses:,} times, for {self.paused:.2f} s in all; later frames moved": self.pauses,
            f"somebody else also sent {', '.join(self.foreign)}": self.foreign,
            f"the log's clock jumped backwards {self.setbacks:,} times; later frames follow on": self.setbacks,
        }
        together = ", ".join(map(str, sorted(self.channels)))
        told[f"frames of channels {together} went onto one bus"] = self.mixed
        return [
            f"{self.out:,} frames in {self.duration:.3f} s; late by {1e3 * late['median']:.2f} ms (median), "
            f"{1e3 * late['p99']:.2f} ms (99 %), {1e3 * late['worst']:.2f} ms (most)",
            *(line for line, holds in told.items() if holds),
            *self.damage,
        ]


@dataclass(frozen=True)
class Replay:
    """What goes onto which buses, and how.

    Attributes:
        buses: that of each channel of the log, by its number; a single one takes all channels.
        speed: how many times faster than recorded.
        loop: how often, None for ever.
        database: of the log, for messages and signals by name; its text in this `encoding`, or what it seems to be.
        last: what is sent last, however it ends.

    Raises:
        InputError: the speed or the number of passes is not possible.
    """

    log: Path
    buses: tuple[BusSettings, ...]
    speed: float = 1.0
    loop: int | None = 1
    database: DatabaseFiles | None = None
    encoding: str | None = None
    chosen: MessageSelection = EVERYTHING
    last: Last = NOTHING

    def __post_init__(self) -> None:
        if not 0 < self.speed < float("inf"):
            raise InputError("--speed", f"is {self.speed:g}", "give a number over 0")
        if self.loop is not None and self.loop < 1:
            raise InputError("--loop", f"is {self.loop}", "give how often, or endless")


def replay(plan: Replay, progress: Progress = silent) -> Replayed:
    """Send the frames of a log with their original timing; Ctrl-C or SIGTERM ends it.

    Args:
        progress: told the share of the log that has been read, and how many frames have been sent.

    Raises:
        InputError: the log or a database cannot be read, it holds CAN FD frames for a classic bus, none that is chosen,
            or a name or value is not possible.
        BusError: the adapter does not open, fails, leaves the bus, or takes no frame for a second.
    """
    share = 0.0

    def read(fraction: float, doing: str) -> None:
        nonlocal share
        share = fraction

    log = None if plan.database is None else load_all(plan.database, plan.encoding)
    reader = logs.read(plan.log, read)
    selection, end = Selection(plan.chosen, log, reader.channels), SafeEnd(plan.last, log)
    done = Replayed()

    def check_any(number: int = 1) -> None:
        if number and not selection.taken and plan.chosen != EVERYTHING:
            problem = f"has none of the frames that are chosen, among {selection.left_out:,}"
            raise InputError(plan.log, problem, "choose others")

    batches = passes(reader, plan.loop, check_any)
    with listening(plan.buses, _HEARD) as channels, stop_requests() as stop, quiet():
        sender = _Sender(plan, channels, end, done)
        try:
            with ahead(map(selection.of, batches)) as chosen:
                told = 0.0
                for sent in sender.send_all(chosen, stop):
                    if sent - told >= _PERIOD:
                        progress(share, f"{done.sent:,} frames")
                        sender.check()
                        told = sent
        finally:
            with handling(lambda number, frame: None, endings()):
                sender.send_last()
        time.sleep(_ECHO)
        channels.finish()
        sender.check()
    done.mixed = len(plan.buses) == 1 < len(done.channels)
    done.stopped = stop.requested
    done.damage = [str(damage) for damage in reader.damage]
    done.left_out, done.missing = selection.left_out, selection.missing
    check_any(not done.stopped)
    return done


class _Sender:
    """Sends frames on the bus of their channel."""

    def __init__(self, plan: Replay, channels: Channels, end: SafeEnd, done: Replayed) -> None:
        self._plan, self._channels, self._done = plan, channels.all, done
        self._last = LastFrames(channels.all, end)
        self._sent = set[tuple[int, Key]]()
        self._news = News(lambda line: LOG.warning("%s: %s", plan.log, line))

    def send_all(self, batches: Iterable[Frames], stop: Stop) -> Iterator[float]:
        """Send frame by frame; when each was sent."""
        timetable: Timetable | None = None
        done = self._done
        for message in (message for batch in batches for message in batch.messages()):
            number = self._number(message)
            if message.is_error_frame or number is None:
                done.skipped += message.is_error_frame
                done.homeless += not message.is_error_frame
                continue
            if timetable is None:
                timetable = Timetable(message.timestamp, time.monotonic() + _LEAD, self._plan.speed)
            deadline = timetable.due(message.timestamp)
            stop.sleep_until(deadline)
            if stop.requested:
                return
            deadline += timetable.held_up(time.monotonic() - deadline)
            self._send(number, message)
            now = time.monotonic()
            done.sent += 1
            done.setbacks, done.pauses, done.paused = timetable.setbacks, timetable.pauses, timetable.paused
            done.lateness.add(now - deadline)
            done.duration = now - timetable.begin
            yield now

    def send_last(self) -> None:
        """Send what is to go out last.

        Raises:
            BusError: an adapter has not taken it, or it may not have got out.
        """
        try:
            self._last.send(self._plan.log)
        finally:
            self._done.last, self._done.dropped = self._last.sent, self._last.dropped

    def check(self) -> None:
        """See how the buses take it; what else is received is of no interest."""
        flows = [flow for channel in self._channels if (flow := getattr(channel.bus, "flow", None))]
        self._done.refused = sum(flow.refused for flow in flows)
        self._news.look(time.monotonic(), lambda: {_HELD_UP: round(1e3 * self._done.paused)})
        for number, channel in enumerate(self._channels):
            messages = self._last.take(number)
            self._done.errors += sum(message.is_error_frame for message in messages)
            self._recognise(number, messages)
            if any(map(is_bus_off, messages)):
                raise BusError(
                    channel.settings.place,
                    f"has left the bus (bus off) by {self._done.sent:,} frames",
                    "see that the bit rate is that of the bus, and to the wiring",
                )
            if channel.receiver.failure is not None:
                raise self._failed(channel, channel.receiver.failure)
            since = getattr(getattr(channel.bus, "flow", None), "refusing", None)
            if since is not None and time.monotonic() - since > _REFUSED:
                raise self._failed(channel, can.CanOperationError(REFUSING))

    def _recognise(self, number: int, messages: Sequence[can.Message]) -> None:
        """Somebody else who sends what is replayed must be known at once."""
        settings = self._channels[number].settings
        for message in messages if settings.interface not in ECHOING else ():
            key = message.arbitration_id, message.is_extended_id
            name = identifier_text(*key)
            sends = message.is_rx and not (message.is_error_frame or message.is_remote_frame)
            if sends and (number, key) in self._sent and name not in self._done.foreign:
                self._done.foreign.append(name)
                LOG.warning("%s: %s is also sent by somebody else", settings.place, name)

    def _number(self, message: can.Message) -> int | None:
        """Of the bus that a frame goes to; None where there is none for it."""
        number = message.channel
        assert isinstance(number, int)
        self._done.channels.add(number)
        if len(self._channels) == 1:
            return 0
        return number if number < len(self._channels) else None

    def _send(self, number: int, message: can.Message) -> None:
        channel = self._channels[number]
        if message.is_fd and not channel.settings.fd:
            place = channel.settings.place
            raise InputError(place, "is opened for classic frames, and the log holds CAN FD frames", "give --fd")
        try:
            send(channel.bus, message)
        except can.CanError as error:
            raise self._failed(channel, error) from error
        self._last.given(number, message)
        self._sent.add((number, (message.arbitration_id, message.is_extended_id)))

    def _failed(self, channel: Channel, error: Exception) -> BusError:
        return BusError(
            channel.settings.place,
            f"failed after {self._done.out:,} frames ({error})",
            "see that the adapter is plugged in, and that somebody listens",
        )
