"""Which signals of a multiplexed message are in which of its frames."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.codec.bits import BitField, Words
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.trace import BoolArray

Whole = NDArray[np.int64]


class Presence:
    """Masks over frames of a message, found from the values of its multiplexers, each of which is read once.

    Args:
        values: gives the values (K,) of a multiplexer, as whole numbers, in all K frames.
    """

    def __init__(self, spec: MessageSpec, values: Callable[[SignalSpec], Whole]) -> None:
        self._spec, self._values = spec, values
        self._read: dict[str, Whole] = {}
        self._masks: dict[tuple[str, tuple[int, ...]], BoolArray | None] = {}

    def of(self, signal: SignalSpec) -> BoolArray | None:
        """(K,) in which frames the signal is; None for all."""
        key = (signal.multiplexer, signal.selected_by)
        if key not in self._masks:
            self._masks[key] = self._found(*key)
        return self._masks[key]

    @cached_property
    def unknown(self) -> int:
        """Number of frames with a multiplexer's value that no signal belongs to, nor any name of its table."""
        wrong: BoolArray | None = None
        for name, known in selections(self._spec).items():
            signal = self._spec.signal(name)
            there, odd = self.of(signal), ~np.isin(self._value(name), known)
            odd = odd if there is None else odd & there
            wrong = odd if wrong is None else wrong | odd
        return 0 if wrong is None else int(np.count_nonzero(wrong))

    def _found(self, multiplexer: str, selected_by: tuple[int, ...]) -> BoolArray | None:
        if not multiplexer:
            return None
        chosen = np.isin(self._value(multiplexer), selected_by)
        above = self.of(self._spec.signal(multiplexer))
        return chosen if above is None else chosen & above

    def _value(self, name: str) -> Whole:
        if name not in self._read:
            self._read[name] = self._values(self._spec.signal(name))
        return self._read[name]


def whole(place: BitField, raw: Words) -> Whole:
    """A multiplexer's values as whole numbers."""
    return np.clip(np.nan_to_num(place.values(raw)), -(2.0**62), 2.0**62).astype(np.int64)


def selections(spec: MessageSpec) -> Mapping[str, list[int]]:
    """The known values of each multiplexer that has any."""
    known: dict[str, set[int]] = {}
    for signal in spec.signals:
        if signal.multiplexer:
            known.setdefault(signal.multiplexer, set()).update(signal.selected_by)
    for signal in spec.signals:
        if signal.is_multiplexer and signal.choices:
            known.setdefault(signal.name, set()).update(signal.choices)
    return {name: sorted(values) for name, values in known.items()}


def pages(spec: MessageSpec, sent: Collection[str]) -> list[dict[str, int]]:
    """Values of the multiplexers that are not sent, in turn, so that every sent signal is in a frame."""
    found: list[dict[str, int]] = []
    for signal in (signal for signal in spec.signals if signal.name in sent):
        page: dict[str, int] = {}
        above = signal
        while above.multiplexer:
            if above.multiplexer not in sent and above.selected_by:
                page[above.multiplexer] = above.selected_by[0]
            above = spec.signal(above.multiplexer)
        if page and page not in found:
            found.append(page)
    return [page for page in found if not any(page.items() < other.items() for other in found)] or [{}]
