"""All that happens on an open bus: frames in to inputs, outputs out to frames, and who rests when.

Nothing here waits for the steps, or is needed by them: whoever has the bus also has what puts outputs to rest.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import can
import numpy as np

from orchestrator.bridge.dependence import STOP
from orchestrator.bridge.line import Line
from orchestrator.bridge.mapping import Coupling
from orchestrator.bridge.safety import State, Status
from orchestrator.bridge.signals.outputs import SentMessage, SentSignal
from orchestrator.bridge.traffic_report import TrafficReport
from orchestrator.bridge.watchdog import Watchdog
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.link import linked
from orchestrator.can.live.news import ErrorStates, News, troubles
from orchestrator.can.live.receiver import Receiver
from orchestrator.progress import Figures

_CONFIRMING = 1.0  # the longest time for the last safe values to get out [s]
_PROMPT = 0.05  # for which they may wait behind what was sent before [s]
_NAP = 0.005  # between two looks whether they have [s]
_LINGERING = 0.05  # before the bus may be closed: adapters forget what they have not sent by then [s]
_SILENCE = 0.1  # for which an adapter may refuse all frames where nothing is received [s]
QUEUE = 4096  # frames that wait to be taken at most; more are dropped and counted


class BusTraffic:
    """Takes from a bus and gives to it.

    Args:
        step: from one step to the next [s].
        news: tells what is not as it should be.

    Attributes:
        inputs: (coupling.width,) received and safe values; those that nobody receives stay as they are.
        over: why the coupling is to end, "" while it goes on.
    """

    def __init__(
        self,
        line: Line,
        coupling: Coupling,
        watchdog: Watchdog,
        step: float,
        news: News,
    ) -> None:
        self._line, self._link, self._coupling, self._watchdog = line, line.link, coupling, watchdog
        self.inputs = np.zeros(coupling.width)
        self.over, self._stopped = "", False
        self._odd, self._foreign, self._unconfirmed = Counter[str](), Counter[str](), list[str]()
        self._pending = False
        self._step, self._rules = step, coupling.rules
        self._status = {signal: Status() for message in coupling.sent for signal in message.guarded}
        self._own = {(message.spec.id, message.spec.extended): message for message in coupling.sent}
        self._gone_out = dict.fromkeys(coupling.sent, -math.inf)
        self._not_finite: set[SentSignal] = set()
        self._news, self._states, self._seen = news, ErrorStates(), (0.0, 0.0)
        self._skipped = 0
        self._stood_in = Counter[SentMessage]()  # safe values that went out since the last step, in place of its frames
        self._number, self._beat, self._late = -1, 0.0, ""
        for message in coupling.reception.messages:
            for signal in message.signals:
                self.inputs[signal.place] = signal.safe

    @property
    def trouble(self) -> str:
        """Why the bus is lost for good, "" while it is not."""
        return "" if self._link.reopens else self._link.trouble

    def receive(self, now: float) -> None:
        """Take what has come, and safe values where nothing came; it is `now` since the beginning [s]."""
        frames = self._line.take()
        self._states.add(frames)
        for frame in frames:
            self._take(frame, now)
        self._news.look(now, self._troubles)
        if filled := self._line.fills(now):
            self._watchdog.note(now, "bus", "alarm", "the bus is full: what is sent does not get out in time")
        if trouble := self._link.trouble:
            self._watchdog.lost(now, trouble, self.inputs)
        if self._watchdog.check(now, self.inputs) and self._rules.ends:
            self.over = self.over or "a received message fell silent, and `on_silence` is `end`"
        self._look(now)
        if filled:
            self._send_safe_values(self._coupling.sent, now)

    def send(self, number: int, outputs: Sequence[float], now: float, lateness: float) -> None:
        """Send the messages that are due up to this step, which began so late [s]; it is the latest one."""
        self._beat = now
        self._late = f"steps are {lateness:.3g} s late" if lateness > self._rules.most_late else ""
        self._inspect(outputs, now)
        self._look(now)
        resting = self._resting()
        for message in self._coupling.sent:
            due = number // message.every - self._number // message.every
            send = due > 0 and not self._too_soon(message, now) and not self._line.full
            self._line.blocked += due * self._line.full
            self._skipped += 0 if self._line.full else due - send
            message.leave_out(max(due - send - self._stood_in.pop(message, 0), 0))
            if send:
                frame = message.frame(outputs, resting)
                if frame is not None:
                    self._give(message, frame, now)
        self._number = number

    def watch(self, now: float) -> float:
        """Send safe values at their periods where no step has ended for too long; for how long none has [s]."""
        waited = self.waited(now)
        if waited <= self._step + self._rules.most_late:
            return waited
        self._late = f"no step has ended for {self._step + self._rules.most_late:.3g} s"
        self._look(now)
        for message in self._coupling.sent:
            due = now - self._gone_out[message] >= self._period(message) and self._number >= 0
            if due and not self._line.full:
                self._send_safe_values([message], now)
                self._stood_in[message] += bool(message.guarded)
        return waited

    def waited(self, now: float) -> float:
        """For how long no step has ended [s]."""
        return now - self._beat

    def end(self, now: float) -> None:
        """Send the safe values, so that nobody acts on the last ones for ever, and see that they get out."""
        self._status = {signal: status.ended() for signal, status in self._status.items()}
        self._line.patience = min(self._line.patience, _PROMPT)
        begun = time.monotonic()
        until = begun + _CONFIRMING
        taken = self._send_safe_values(self._coupling.sent, now, until)
        while not (out := self._got_out(now + time.monotonic() - begun)) and time.monotonic() < until:
            time.sleep(_NAP)
        if not (out and taken):
            self._unconfirmed = [message.spec.name for message in self._coupling.sent if message.guarded]
            self._pending = taken and self._line.waits and self._link.stay()
        time.sleep(_LINGERING)

    def status(self, now: float) -> Figures:
        """How it goes, of the load since the last call; it is `now` since the beginning [s]."""
        received, sent = self._coupling.reception.statistics.frames, self._link.out.total()
        before, busy = self._seen
        self._seen = now, self._link.busy
        load = (self._link.busy - busy) / max(now - before, 1e-9)
        told = {what: count for what, count in self._troubles().items() if count}
        shown = ["bus lost"] * bool(self._link.trouble) + [f"{count:,} {what}" for what, count in told.items()]
        line = ", ".join([f"{received:,} received", f"{sent:,} sent", f"load {100 * load:.0f} %", *shown])
        return Figures.of(line, {"time": now, "received": received, "sent": sent, "load": round(load, 4)} | told)

    def _troubles(self) -> dict[str, int]:
        """Words for what is not as it should be -> how often it was."""
        link = self._link
        lost = {"frames dropped": self._line.receiver.dropped, "frames without room": link.no_room}
        return troubles(self._coupling.reception.statistics) | self._states.counts | lost

    def report(self, now: float) -> TrafficReport:
        """What has passed until now [s]."""
        link, sent = self._link, self._coupling.sent_statistics
        out = link.out
        sent.messages = Counter({message.spec.name: out[key] for key, message in self._own.items()})
        return TrafficReport(
            self._coupling.reception.statistics,
            self._line.receiver.dropped,
            sent,
            out.total(),
            link.acknowledges,
            link.no_room,
            link.unsent,
            self._skipped,
            self._line.blocked,
            tuple(link.losses),
            link.loss_count,
            link.malformed,
            link.refused,
            link.trouble,
            self.over,
            self._stopped,
            tuple(self._unconfirmed),
            self._pending,
            dict(self._odd),
            dict(self._foreign),
            self._watchdog.report(now),
        )

    def _take(self, frame: can.Message, now: float) -> None:
        key = (frame.arbitration_id, frame.is_extended_id)
        if key in self._own and not frame.is_error_frame:
            self._recognise(key, now)
        taken = self._coupling.reception.take(frame, self.inputs)
        if taken is None:
            return
        if not self._link.trouble:
            self._watchdog.took(taken, now)
        if any(signal.input == STOP and self.inputs[signal.place] for signal in taken.good):
            self._stopped = True
            self.over = self.over or "the stop signal was received"

    def _recognise(self, key: tuple[int, bool], now: float) -> None:
        """Somebody else who sends a message of ours must be known at once."""
        name = self._own[key].spec.name
        self._foreign[name] += 1
        if self._foreign[name] == 1:
            self._watchdog.note(now, name, "alarm", f"{name} is also sent by somebody else")

    def _inspect(self, outputs: Sequence[float], now: float) -> None:
        """Find the outputs that are not finite; the first time that is said at once."""
        self._not_finite.clear()
        for message in self._coupling.sent:
            for signal in message.signals:
                value = outputs[signal.place]
                if math.isfinite(value):
                    continue
                self._not_finite.add(signal)
                self._odd[signal.output] += 1
                if self._odd[signal.output] == 1:
                    ends = f"{message.spec.name} is not sent" if signal.safe is None else f"{signal.safe:g} is sent"
                    self._watchdog.note(now, signal.output, "alarm", f"{signal.output} is {value}; {ends}")

    def _look(self, now: float) -> None:
        """See which outputs rest and which go on; what changes is said."""
        changed: dict[str, list[str]] = {}
        for signal, status in self._status.items():
            why = self._why(signal)
            self._status[signal] = after = status.seen(now, not why, self._rules)
            if after.state is not status.state:
                again = State.INIT if status.state is State.INIT else "is sent again"
                changed.setdefault(f"rests: {why}" if after.rests else again, []).append(signal.spec.name)
        for what, names in changed.items():
            said = "" if what == State.INIT else f"{', '.join(names)} {what}"
            self._watchdog.note(now, ", ".join(names), "rests" if what.startswith("rests") else "runs", said)

    def _why(self, signal: SentSignal) -> str:
        """Why the signal is to rest; "" where all is good."""
        missing = signal.needs & self._watchdog.resting
        if missing:
            return f"without {', '.join(sorted(missing))}"
        if signal in self._not_finite:
            return f"{signal.output} is not finite"
        return "the bus is full" if self._line.full else self._late

    def _resting(self) -> set[SentSignal]:
        return {signal for signal, status in self._status.items() if status.rests}

    def _period(self, message: SentMessage) -> float:
        return message.every * self._step

    def _too_soon(self, message: SentMessage, now: float) -> bool:
        """Whether steps are being made up for, and its latest frame is not half a period old."""
        return bool(self._late) and now - self._gone_out[message] < 0.5 * self._period(message)

    def _send_safe_values(self, messages: Sequence[SentMessage], now: float, until: float = 0.0) -> bool:
        """Whether the adapter took them; it may take until then, on the clock of `time.monotonic` [s]."""
        frames = [(message, frame) for message in messages for frame in message.safe_frames()]
        taken = [self._give(message, frame, now, until - time.monotonic()) for message, frame in frames]
        return all(taken)

    def _got_out(self, now: float) -> bool:
        """Whether all that was sent is on the bus; where it has become full, the safe values are to be first there."""
        self._line.take()
        if self._line.fills(now):
            self._send_safe_values(self._coupling.sent, now)
        return self._line.quiet()

    def _give(self, message: SentMessage, frame: can.Message, now: float, patience: float = 0.0) -> bool:
        """Give a frame to the adapter; whether it took it."""
        self._gone_out[message] = now
        return self._line.give(frame, now, max(0.0, patience))


@contextmanager
def on_bus(
    settings: BusSettings,
    coupling: Coupling,
    step: float,
    say: Callable[[str], None],
    arrived: Callable[[], None] = lambda: None,
) -> Iterator[BusTraffic]:
    """The traffic of a bus that is open for the block.

    Args:
        say: takes lines for people.
        arrived: called when there is something to receive, by another thread.

    Raises:
        BusError: the adapter does not open.
    """
    watchdog = Watchdog(coupling.reception.messages, say)
    patience = min((message.silence for message in coupling.reception.messages), default=_SILENCE)
    news = News(lambda line: say(f"{settings.place}: {line}"))
    with linked(settings, patience, say) as link, Receiver(link, QUEUE, arrived) as receiver:
        line = Line(link, receiver, Backlog(settings), coupling.rules.most_late)
        yield BusTraffic(line, coupling, watchdog, step, news)
