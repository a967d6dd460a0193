"""What goes out last: given to the adapters, and seen to get out as far as that can be known."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress

import can

from fmus.errors import BusError
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import send
from orchestrator.can.live.channels import Channel
from orchestrator.can.sending.safe_end import SafeEnd, frame_text

_WAY = 0.3  # for which what was sent before may still wait [s]
_CONFIRMING = 1.0  # for which the last frames may [s]
_NAP = 0.005  # between two looks [s]


class LastFrames:
    """The last frames, and what of all that was sent still waits in each adapter.

    Attributes:
        sent: names of those that adapters took, as `123#00`.
        dropped: frames before them that had no room on the bus and would have kept them from it.
    """

    def __init__(self, channels: Sequence[Channel], end: SafeEnd) -> None:
        self._channels, self._end = channels, end
        self._backlogs = [Backlog(channel.settings) for channel in channels]
        self.sent: list[str] = []
        self.dropped = 0

    def given(self, number: int, message: can.Message) -> None:
        """An adapter has taken a frame."""
        self._backlogs[number].sent(message, time.monotonic())
        self._end.note(message, number)

    def take(self, number: int) -> list[can.Message]:
        """What has been received on a bus since the last call."""
        messages, backlog = self._channels[number].receiver.take(), self._backlogs[number]
        for message in messages:
            if message.is_rx and not message.is_error_frame:
                backlog.heard(message)
        backlog.look(time.monotonic())
        return messages

    def send(self, place: object) -> None:
        """Send them; `place` names what they follow in errors.

        Raises:
            BusError: an adapter has not taken one, or it may not have got out.
        """
        frames = self._end.frames(len(self._channels))
        used = sorted({number for number, _ in frames})
        crowded = self._waiting(used, _WAY)
        for number in crowded:
            self._make_room(number)
        until, failed, kept = time.monotonic() + _CONFIRMING, used, list[int]()
        problems: list[str] = []
        while failed and time.monotonic() < until:
            before, self.sent = self._failures(), []
            problems = [problem for number, message in frames if (problem := self._sent(number, message))]
            kept = self._waiting(used, max(until - time.monotonic(), _WAY))
            failed = [number for number in used if self._failures()[number] != before[number]]
            time.sleep(_NAP if failed else 0.0)
        kept += [number for number in failed if number not in kept]
        staying = [number for number in {*crowded, *kept} if hasattr(self._channels[number].bus, "stays")]
        for number in staying:  # of the crowded ones, too: what is out is known by an estimate
            self._channels[number].bus.stays = True  # type: ignore[attr-defined]
        if problems:
            problem = f"ended, and was NOT followed by {' and '.join(problems)}"
        elif kept:
            why = " and ".join(map(self._why, kept))
            pending = ", and the adapter sends it when it can" if {*kept} <= {*staying} - {*failed} else ""
            problem = f"ended, and {', '.join(self.sent)} may not have got out: {why}{pending}"
        else:
            return
        raise BusError(place, problem, "stop the machine otherwise")

    def _waiting(self, numbers: Sequence[int], patience: float) -> list[int]:
        """The buses on which something still waits after so long [s]."""
        until, left = time.monotonic() + patience, list(numbers)
        while left:
            for number in list(left):
                self.take(number)
                if self._backlogs[number].empty() and not getattr(self._channels[number].bus, "owed", 0):
                    left.remove(number)
            if time.monotonic() >= until:
                break
            time.sleep(_NAP)
        return left

    def _failures(self) -> list[int]:
        """Of each adapter the frames that it has refused, and those of which it never said whether it took them."""
        return [getattr(getattr(channel.bus, "flow", None), "failed", 0) for channel in self._channels]

    def _why(self, number: int) -> str:
        """Why something waits on a bus."""
        flow = getattr(self._channels[number].bus, "flow", None)
        stopped = self._backlogs[number].empty()
        why = "refuses frames" if flow and flow.refusing else "has stopped to answer" if stopped else "is full"
        return f"{self._channels[number].settings.place} {why}"

    def _make_room(self, number: int) -> None:
        """Have an adapter forget what it has not sent, where it can."""
        waiting = self._backlogs[number].waiting().total()
        try:
            self._channels[number].bus.flush_tx_buffer()
        except (NotImplementedError, can.CanError):
            return  # what follows waits behind it
        self._backlogs[number].clear()
        self.dropped += waiting

    def _sent(self, number: int, message: can.Message) -> str:
        """Why an adapter has not taken a frame; nothing where it has."""
        channel, name = self._channels[number], frame_text(message)
        try:
            send(channel.bus, message)
        except Exception as error:  # drivers raise anything
            if getattr(channel.bus, "owed", 0):  # it is left behind all that the adapter has, to go when that goes on
                channel.bus.insists = channel.bus.stays = True  # type: ignore[attr-defined]
                with suppress(can.CanError):
                    channel.bus.send(message, timeout=0.0)
                    self.sent.append(name)
                    return ""
            return f"{name} on {channel.settings.place} ({error})"
        self._backlogs[number].sent(message, time.monotonic())
        self.sent.append(name)
        return ""
