"""All that happens on an open bus: frames in to inputs, outputs out to frames, and who rests when.

Nothing here waits for the steps, or is needed by them: whoever has the bus also has what puts outputs to rest.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

import can
import numpy as np

from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.bridge.mapping import Coupling
from orchestrator.bridge.safety.dependence import STOP
from orchestrator.bridge.safety.resting import OutputState, OutputStatus
from orchestrator.bridge.safety.watchdog import Watchdog
from orchestrator.bridge.signals.outputs import SentMessage, SentSignal
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.line import SendingLine
from orchestrator.can.live.link import linked
from orchestrator.can.live.news import ErrorStates, News, troubles
from orchestrator.can.live.receiver import Receiver
from orchestrator.progress import Figures

_CONFIRMING = 1.0  # the longest time for the last safe values to get out [s]
_PROMPT = 0.05  # for which they may wait behind what was sent before [s]
_NAP = 0.005  # between two looks whether they have [s]
_LINGERING = 0.05  # before the bus may be closed: adapters forget what they have not sent by then [s]
_SILENCE = 0.1  # for which an adapter may refuse all frames where nothing is received [s]
_FULL = "the bus is full, and the adapter sends them when it has room"
_STOPPED = "the adapter has stopped to answer, and sends them when it goes on"
QUEUE = 4096  # frames that wait to be taken at most; more are dropped and counted


class BusTraffic:
    """Takes from buses and gives to them.

    Args:
        lines: the buses; messages know theirs by its number.
        step: from one step to the next [s].
        news: tells what is not as it should be.

    Attributes:
        inputs: (coupling.width,) received and safe values; those that nobody receives stay as they are.
        over: why the coupling is to end, "" while it goes on.
    """

    def __init__(
        self,
        lines: Sequence[SendingLine],
        coupling: Coupling,
        watchdog: Watchdog,
        step: float,
        news: News,
    ) -> None:
        self._lines, self._coupling, self._watchdog = tuple(lines), coupling, watchdog
        self.inputs = np.zeros(coupling.width)
        self.over, self._stopped = "", False
        self._odd, self._foreign, self._unconfirmed = Counter[str](), Counter[str](), list[SentMessage]()
        self._pending = ""
        self._step, self._rules = step, coupling.rules
        self._status = {signal: OutputStatus() for message in coupling.sent for signal in message.guarded}
        self._home = {signal: self._line(message) for message in coupling.sent for signal in message.signals}
        self._own = {message.key: message for message in coupling.sent}
        self._gone_out = dict.fromkeys(coupling.sent, -math.inf)
        self._not_finite: set[SentSignal] = set()
        self._news, self._states, self._seen = news, ErrorStates(), (0.0, [0.0] * len(lines))
        self._start = math.inf  # of the beginning, on the clock of `time.monotonic` [s]
        self._early: deque[tuple[float, int, can.Message]] = deque(maxlen=QUEUE)  # with when they came, and their bus
        self._skipped = 0
        self._stood_in = Counter[SentMessage]()  # safe values that went out since the last step, in place of its frames
        self._number, self._beat, self._late = -1, 0.0, "no step has ended"
        for message in coupling.reception.messages:
            for signal in message.signals:
                self.inputs[signal.place] = signal.safe

    @property
    def trouble(self) -> str:
        """Why a bus is lost for good, "" while none is."""
        return next((line.link.trouble for line in self._lines if not line.link.reopens and line.link.trouble), "")

    def listen(self, at: float) -> None:
        """Keep the latest of what comes before the beginning; it is `at` on the clock of `time.monotonic` [s]."""
        for bus, line in enumerate(self._lines):
            self._early += [(at, bus, frame) for frame in line.take()]

    def begin(self, start: float) -> None:
        """Take what has come until now as old as it is; the beginning is at `start` of that clock [s]."""
        self._start = start
        self._states.add([frame for _, _, frame in self._early])
        for at, bus, frame in self._early:
            self._take(frame, bus, at - start)
        self._early.clear()

    def receive(self, now: float) -> None:
        """Take what has come, and safe values where nothing came; it is `now` since the beginning [s]."""
        for bus, line in enumerate(self._lines):
            frames = line.take()
            self._states.add(frames)
            for frame in frames:
                self._take(frame, bus, now)
        self._news.look(now, self._troubles)
        filled = [bus for bus, line in enumerate(self._lines) if line.fills(now)]
        for bus, line in enumerate(self._lines):
            if bus in filled:
                full = f"{line.name} is full: what is sent does not get out in time"
                self._watchdog.note(now, line.name, "alarm", full)
            if trouble := line.link.trouble:
                self._watchdog.lost(now, trouble, self.inputs, bus)
        if self._watchdog.check(now, self.inputs) and self._rules.ends:
            self.over = self.over or "a received message fell silent, and `on_silence` is `end`"
        self._look(now)
        self._send_safe_values([message for message in self._coupling.sent if message.place.number in filled], now)

    def send(self, number: int, outputs: Sequence[float], now: float, lateness: float) -> None:
        """Send the messages that are due up to this step, which began so late [s]; it is the latest one."""
        self._beat = now
        self._late = f"steps are {lateness:.3g} s late" if lateness > self._rules.most_late else ""
        self._inspect(outputs, now)
        self._look(now)
        resting = self._resting()
        for message in self._coupling.sent:
            due = self._due(message, number)
            send = due > 0 and not self._too_soon(message, now) and not self._line(message).full
            self._leave_out(message, due - send)
            if send:
                frame = message.frame(outputs, resting)
                if frame is not None and self._held_up(now):
                    self._skipped += 1
                elif frame is not None:
                    self._give(message, frame, now)
        self._number = number

    def pass_over(self, number: int) -> None:
        """Count what was due up to this step, which came too late for it: only safe values are still to be sent."""
        for message in self._coupling.sent:
            self._leave_out(message, self._due(message, number))
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
            if due and not self._line(message).full:
                self._send_safe_values([message], now)
                self._stood_in[message] += bool(message.guarded)
        return waited

    def waited(self, now: float) -> float:
        """For how long no step has ended [s]."""
        return now - self._beat

    def end(self, now: float) -> None:
        """Send the safe values, so that nobody acts on the last ones for ever, and see that they get out."""
        self._status = {signal: status.ended() for signal, status in self._status.items()}
        for line in self._lines:
            line.patience = min(line.patience, _PROMPT)
            line.link.persists = True
            line.fails()
        begun = time.monotonic()
        until = begun + _CONFIRMING
        taken = self._send_safe_values(self._coupling.sent, now, until)
        crowded = [line for line in self._lines if line.full]
        while (open_ := self._not_out(now + time.monotonic() - begun)) and time.monotonic() < until:
            crowded += [line for line in self._lines if line.full and line not in crowded]
            time.sleep(_NAP)
        doubtful = [message for message in self._coupling.sent if message.guarded]
        self._unconfirmed = [message for message in doubtful if self._line(message) in open_ or message not in taken]
        left = [self._left(message, message in taken) for message in self._unconfirmed]
        self._pending = " and ".join(dict.fromkeys(left)) if all(left) else ""
        for line in crowded:  # what is out is known by an estimate, which a paused computer deceives
            line.link.stay()
        time.sleep(_LINGERING)

    def _left(self, message: SentMessage, taken: bool) -> str:
        """Leave safe values that have not got out with the adapter; why, "" where it does not keep them."""
        line = self._line(message)
        if line.link.refusing:
            return ""
        kept = line.link.stay() if taken else all(map(line.link.insist, message.safe_frames()))
        return (_FULL if line.waits else _STOPPED) if kept else ""

    def status(self, now: float) -> Figures:
        """How it goes, of the load since the last call; it is `now` since the beginning [s]."""
        links = [line.link for line in self._lines]
        received, sent = self._coupling.reception.statistics.frames, sum(link.out.total() for link in links)
        (before, busy), now_busy = self._seen, [link.busy for link in links]
        self._seen = now, now_busy
        loads = [(after - earlier) / max(now - before, 1e-9) for earlier, after in zip(busy, now_busy, strict=True)]
        told = {what: count for what, count in self._troubles().items() if count}
        shown = ["bus lost" for link in links if link.trouble] + [f"{count:,} {what}" for what, count in told.items()]
        load = " and ".join(f"{100 * load:.0f} %" for load in loads)
        line = ", ".join([f"{received:,} received", f"{sent:,} sent", f"load {load}", *shown])
        figures = {"time": now, "received": received, "sent": sent, "load": round(max(loads), 4)}
        return Figures.of(line, figures | told)

    def _troubles(self) -> dict[str, int]:
        """Words for what is not as it should be -> how often it was."""
        lost = {
            "frames dropped": sum(line.receiver.dropped for line in self._lines),
            "frames dropped that came in a pause": sum(line.receiver.late for line in self._lines),
            "frames without room": sum(line.link.no_room for line in self._lines),
            "lines of the adapter that are no frames": sum(line.link.malformed for line in self._lines),
            "frames and commands that the adapter refused": sum(line.link.refused for line in self._lines),
            "answers that the adapter owes for good": sum(line.link.unanswered for line in self._lines),
            "sent values limited to fit": self._coupling.sent_statistics.saturated.total(),
            "sent values limited by `limit`": self._coupling.sent_statistics.limited.total(),
        }
        return troubles(self._coupling.reception.statistics) | self._states.counts | lost

    def report(self, now: float) -> TrafficReport:
        """What has passed until now [s]."""
        links, sent = [line.link for line in self._lines], self._coupling.sent_statistics
        out = [link.out for link in links]
        sent.messages = Counter(
            {message.name: out[bus][identifier, extended] for (bus, identifier, extended), message in self._own.items()}
        )
        return TrafficReport(
            self._coupling.reception.statistics,
            sum(line.receiver.dropped for line in self._lines),
            sum(line.receiver.late for line in self._lines),
            sent,
            sum(count.total() for count in out),
            all(link.acknowledges for link in links),
            sum(link.no_room for link in links),
            sum(link.unsent for link in links),
            self._skipped,
            sum(line.blocked for line in self._lines),
            tuple(sorted((loss for link in links for loss in link.losses), key=lambda loss: loss.stamp)),
            sum(link.loss_count for link in links),
            sum(link.malformed for link in links),
            sum(link.refused for link in links),
            next((link.trouble for link in links if link.trouble), ""),
            self.over,
            self._stopped,
            tuple(message.name for message in self._unconfirmed),
            self._pending,
            dict(self._odd),
            dict(self._foreign),
            self._watchdog.report(now),
        )

    def _take(self, frame: can.Message, bus: int, now: float) -> None:
        key = (bus, frame.arbitration_id, frame.is_extended_id)
        if key in self._own and not (frame.is_error_frame or frame.is_remote_frame):
            self._recognise(key, now)
        taken = self._coupling.reception.take(frame, self.inputs, bus)
        if taken is None:
            return
        if not self._lines[bus].link.trouble:
            self._watchdog.took(taken, now)
        if not self._stopped and any(signal.input == STOP and self.inputs[signal.place] for signal in taken.good):
            self._stopped = True
            self._watchdog.note(now, taken.message.name, "alarm", "the stop signal was received")
            self.over = self.over or "the stop signal was received"

    def _recognise(self, key: tuple[int, int, bool], now: float) -> None:
        """Somebody else who sends a message of ours must be known at once."""
        name = self._own[key].name
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
                    ends = f"{message.name} is not sent" if signal.safe is None else f"{signal.safe:g} is sent"
                    self._watchdog.note(now, signal.output, "alarm", f"{signal.output} is {value}; {ends}")

    def _look(self, now: float) -> None:
        """See which outputs rest and which go on; what changes is said."""
        changed: dict[str, list[str]] = {}
        for signal, status in self._status.items():
            why = self._why(signal)
            proven = status.state is not OutputState.SAFE or self._watchdog.proven(signal.needs, self._rules.after)
            self._status[signal] = after = status.seen(now, not why, self._rules, proven)
            if after.state is not status.state:
                again = OutputState.INIT if status.state is OutputState.INIT else "is sent again"
                rests = f"rests{' for good' * self._rules.latched}: {why}"
                changed.setdefault(rests if after.rests else again, []).append(signal.spec.name)
        for what, names in changed.items():
            said = "" if what == OutputState.INIT else f"{', '.join(names)} {what}"
            self._watchdog.note(now, ", ".join(names), "rests" if what.startswith("rests") else "runs", said)

    def _why(self, signal: SentSignal) -> str:
        """Why the signal is to rest; "" where all is good."""
        missing = signal.needs & self._watchdog.resting
        if missing:
            return f"without {', '.join(sorted(missing))}"
        if signal in self._not_finite:
            return f"{signal.output} is not finite"
        line = self._home[signal]
        return f"{line.name} is full" if line.full else self._late

    def _due(self, message: SentMessage, number: int) -> int:
        """How many of its frames are due after the last step, up to this one."""
        return number // message.every - self._number // message.every

    def _leave_out(self, message: SentMessage, count: int) -> None:
        """Send so many frames less than are due."""
        line = self._line(message)
        line.blocked += count * line.full
        self._skipped += count * (not line.full)
        message.leave_out(max(count - self._stood_in.pop(message, 0), 0))

    def _resting(self) -> set[SentSignal]:
        return {signal for signal, status in self._status.items() if status.rests}

    def _period(self, message: SentMessage) -> float:
        return message.every * self._step

    def _too_soon(self, message: SentMessage, now: float) -> bool:
        """Whether steps are being made up for, and its latest frame is not half a period old."""
        return bool(self._late) and now - self._gone_out[message] < 0.5 * self._period(message)

    def _held_up(self, now: float) -> bool:
        """Whether this process has stood still since it was `now` [s]: what it was about to send is old."""
        return time.monotonic() - self._start - now > self._rules.most_late

    def _line(self, message: SentMessage) -> SendingLine:
        return self._lines[message.place.number]

    def _send_safe_values(self, messages: Sequence[SentMessage], now: float, until: float = 0.0) -> list[SentMessage]:
        """Those that their adapters took; they may take until then, on the clock of `time.monotonic` [s]."""
        frames = [(message, frame) for message in messages for frame in message.safe_frames()]
        taken = [(message, self._give(message, frame, now, until - time.monotonic())) for message, frame in frames]
        refused = {message for message, took in taken if not took}
        return [message for message in messages if message not in refused]

    def _not_out(self, now: float) -> list[SendingLine]:
        """The buses on which not all is that was sent; where one has become full, the safe values are to be first, and
        where they were refused, or nobody knows what became of them, they are sent again."""
        open_ = []
        for line in self._lines:
            line.take()
            filled, quiet, failed = line.fills(now), line.quiet(), line.fails()
            if filled or failed or not quiet:
                open_.append(line)
            if filled or failed:
                self._send_safe_values([message for message in self._coupling.sent if self._line(message) is line], now)
        return open_

    def _give(self, message: SentMessage, frame: can.Message, now: float, patience: float = 0.0) -> bool:
        """Give a frame to the adapter; whether it took it."""
        self._gone_out[message] = now
        return self._line(message).give(frame, now, max(0.0, patience))


@contextmanager
def on_buses(
    buses: Sequence[BusSettings],
    coupling: Coupling,
    step: float,
    say: Callable[[str], None],
    arrived: Callable[[], None] = lambda: None,
) -> Iterator[BusTraffic]:
    """The traffic of buses that are open for the block.

    Args:
        say: takes lines for people.
        arrived: called when there is something to receive, by another thread.

    Raises:
        BusError: an adapter does not open.
    """
    messages, patience = coupling.reception.messages, coupling.rules.most_late
    watchdog, place = Watchdog(messages, say), " and ".join(bus.place for bus in buses)
    news = News(lambda line: say(f"{place}: {line}"))
    with ExitStack() as stack:
        lines = []
        for number, bus in enumerate(buses):
            silences = [message.silence for message in messages if message.place.number == number]
            link = stack.enter_context(linked(bus, min(silences, default=_SILENCE), say))
            receiver = stack.enter_context(Receiver(link, QUEUE, arrived, patience))
            lines.append(
                SendingLine(link, receiver, Backlog(bus), patience, "the bus" if len(buses) == 1 else bus.place)
            )
        yield BusTraffic(lines, coupling, watchdog, step, news)
