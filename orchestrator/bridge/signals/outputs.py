"""Outputs of components on their way to frames, one message at a time.

A value that does not fit its signal is limited. One that is not finite puts its signal to the safe value, or, where
there is none, keeps its message from being sent. All are counted. Counter and checksum of a message are filled in.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import cycle

import can

from orchestrator.bridge.signals.location import MessageLocation
from orchestrator.can.codec.fields import unfit
from orchestrator.can.codec.multiplexing import pages
from orchestrator.can.database.message import SignalSpec
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.statistics import FrameStatistics, add
from orchestrator.crossing import Crossing


@dataclass(frozen=True, eq=False)
class SentSignal:
    """How a signal takes an output.

    Attributes:
        output: component.output.
        place: its number among the outputs that are read.
        crossing: from the output's unit to the signal's.
        safe: value that is sent while it rests [unit of the output].
        needs: inputs without which it rests.
        magnitude: largest amount; change: largest one from frame to frame, but to the safe value [unit of the output].
    """

    spec: SignalSpec
    output: str
    place: int
    crossing: Crossing
    safe: float | None
    needs: frozenset[str] = frozenset()
    magnitude: float = math.inf
    change: float = math.inf


class SentMessage:
    """A message that is sent.

    Attributes:
        spec: what it is in its database, at its `place`.
        every: communication steps from one frame to the next.
        pages: values of multiplexers that are not sent themselves; frames take turns with them.
    """

    def __init__(
        self,
        place: MessageLocation,
        signals: Sequence[SentSignal],
        every: int,
        statistics: FrameStatistics,
        switched: bool = False,
    ) -> None:
        spec = place.message
        self.place, self.spec, self.signals, self.every = place, spec, tuple(signals), every
        self._statistics = statistics
        self._encoder = SingleEncoder(spec, statistics, switched)
        self._last = {signal: signal.safe for signal in signals if signal.safe is not None}  # where its machine rests
        self._names = [signal.spec.name for signal in signals]
        self.pages = pages(spec, self._names)
        self._turns = cycle(self.pages)

    @property
    def name(self) -> str:
        """What it is called."""
        return self.place.name

    @property
    def key(self) -> tuple[int, int, bool]:
        """What its frames are known by: number of the bus, identifier, and whether it is an extended one."""
        return self.place.number, self.spec.id, self.spec.extended

    def notes(self) -> list[str]:
        """What is sent without having been asked for, a line each."""
        spec, protection = self.spec, self.spec.protection
        filled = {*self._names, *(name for page in self.pages for name in page)}
        filled |= {protection.counter, protection.checksum} if protection else set()
        unset = [signal for signal in spec.signals if signal.name not in filled]
        others = [signal.name for signal in unset]
        turns, rests = " and ".join(self.pages[0]), "rests" if len(others) == 1 else "rest"
        told = {
            f"its {len(self.pages)} pages take turns, since nothing is sent in {turns}": len(self.pages) > 1,
            f"{', '.join(others)} {rests} at the initial value, or zero, since nothing is sent there": others,
        }
        told |= {
            f"the initial value {signal.initial:g} of {signal.name} is not sent: {limits}": True
            for signal in unset
            if (limits := unfit(signal))
        }
        return [f"{self.name}: {line}" for line, holds in told.items() if holds]

    @property
    def guarded(self) -> list[SentSignal]:
        """Signals with a safe value."""
        return [signal for signal in self.signals if signal.safe is not None]

    def frame(self, outputs: Sequence[float], resting: Collection[SentSignal] = ()) -> can.Message | None:
        """The next frame, with these values of the outputs that are read; None where it cannot have all of them.

        Args:
            resting: signals that have their safe values.
        """
        whole = True
        for signal in self.signals:
            value = outputs[signal.place]
            finite = math.isfinite(value)
            self._statistics.not_finite.update([] if finite else [signal.spec.name])
            if signal.safe is not None and (signal in resting or not finite):
                self._fill(signal, signal.safe)
            elif finite:
                self._fill(signal, self._limited(signal, value))
            else:
                whole = False
        if not whole:
            return None
        self._encoder.turn_to(next(self._turns))
        return self._encoder.frame()

    def safe_frames(self) -> list[can.Message]:
        """The frames with the safe values, and what was sent last in signals without one; none without any.

        Of a multiplexed message they are those that hold one of them, and then that which the multiplexer asks for.
        """
        for signal in self.guarded:
            assert signal.safe is not None
            self._fill(signal, signal.safe)
        chosen = {name: self._encoder.raw(name) for name in self._names if self.spec.signal(name).is_multiplexer}
        turns = pages(self.spec, [signal.spec.name for signal in self.guarded if signal.spec.name not in chosen])
        if chosen:
            turns = [*filter(None, turns), chosen]
        frames = []
        for page in turns if self.guarded else []:
            self._encoder.turn_to(page)
            frames.append(self._encoder.frame())
        return [frame for frame in frames if frame is not None]

    def leave_out(self, count: int) -> None:
        """Count frames that are due and not sent."""
        self._encoder.leave_out(count)

    def _limited(self, signal: SentSignal, value: float) -> float:
        """The value within what was asked for of it."""
        limited = min(max(value, -signal.magnitude), signal.magnitude)
        last = self._last.get(signal)
        if last is not None:
            limited = min(max(limited, last - signal.change), last + signal.change)
        add(self._statistics.limited, signal.spec.name, int(limited != value))
        return limited

    def _fill(self, signal: SentSignal, value: float) -> None:
        self._last[signal] = value
        self._encoder.set(signal.spec, signal.crossing.conversion(value))
