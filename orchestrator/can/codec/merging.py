"""Series of several messages, each with stamps of its own, onto common stamps: batch by batch, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.frames import since
from orchestrator.can.statistics import FrameStatistics
from orchestrator.trace import BoolArray, FloatArray, Trace

PATIENCE = 0.1  # [s]: by how much frames of different batches may be out of order


@dataclass(frozen=True)
class Series:
    """The signals of one message.

    Attributes:
        time: (K,) stamps of its frames, in the order of the stream [s].
        values: public signal name -> (K,) values; NaN where a multiplexed signal is not in the frame.
        units: public signal name -> unit, where it is known.
    """

    time: FloatArray
    values: Mapping[str, FloatArray]
    units: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | NDArray[np.intp] | BoolArray) -> Series:
        return Series(self.time[rows], {name: column[rows] for name, column in self.values.items()}, self.units)

    def renamed(self, name: Callable[[str], str]) -> Series:
        """The same with other names of its signals."""
        values = {name(signal): column for signal, column in self.values.items()}
        return Series(self.time, values, {name(signal): unit for signal, unit in self.units.items()})


def joined(parts: Sequence[Series]) -> Series:
    """Parts of one message's series in a row."""
    if len(parts) == 1:
        return parts[0]
    values = {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values}
    return Series(np.concatenate([part.time for part in parts]), values, parts[0].units)


def ascending(series: Series) -> Series:
    """The series sorted by its stamps, where they are not ascending already."""
    if np.all(series.time[1:] >= series.time[:-1]):
        return series
    return series[np.argsort(series.time, kind="stable")]


@dataclass
class Merger:
    """Rows at all stamps of all messages, where every signal holds its last finite value, NaN before the first.

    Samples newer than the newest less `patience` are kept back
    until later ones have come, so that disorder up to there is sorted; a sample older than the last row passed on is
    dropped and counted. Signals in `interpolated` run linearly between their own samples instead, which needs a
    whole recording in one feed: between batches they hold.

    Attributes:
        signals: names of the columns, in their order.
        start: stamp that becomes time 0 [s].
    """

    signals: Sequence[str]
    start: float = 0.0
    patience: float = PATIENCE
    interpolated: Collection[str] = ()
    name: str = "can"
    statistics: FrameStatistics = field(default_factory=FrameStatistics)
    _held: dict[str, float] = field(default_factory=dict)
    _units: dict[str, str] = field(default_factory=dict)
    _kept: dict[Hashable, Series] = field(default_factory=dict)
    _passed: float = -np.inf

    def feed(self, batch: Mapping[Any, Series]) -> Trace:
        """The rows that can be told after these series, by what they are of; maybe none."""
        for message, series in batch.items():
            if len(series):
                self._units |= series.units
                parts = [self._kept[message]] if message in self._kept else []
                self._kept[message] = joined([*parts, series])
        newest = max((float(np.max(series.time)) for series in self._kept.values() if len(series)), default=-np.inf)
        return self._rows(newest - self.patience)

    def finish(self) -> Trace:
        """The rows that were kept back."""
        return self._rows(np.inf)

    def _rows(self, until: float) -> Trace:
        """Rows with stamps up to `until`; what is newer stays."""
        due: list[Series] = []
        for message, series in self._kept.items():
            ordered = ascending(series)
            end = int(np.searchsorted(ordered.time, until, side="right"))
            due.append(self._in_time(ordered[:end]))
            self._kept[message] = ordered[end:]
        samples = [Series(since(self.start, series.time), series.values, series.units) for series in due if len(series)]
        time, places = _union([series.time for series in samples])
        held = dict(self._held)
        found: dict[str, FloatArray] = {}
        for series, rows in zip(samples, places, strict=True):
            found |= self._columns(series, rows, time)
        columns = {
            name: found[name] if name in found else np.full(len(time), held.get(name, np.nan)) for name in self.signals
        }
        if len(time):
            self._passed = max(float(series.time[-1]) for series in due if len(series))
        units = {name: unit for name, unit in self._units.items() if name in columns}
        return Trace(time, columns, units, self.name)

    def _in_time(self, series: Series) -> Series:
        late = int(np.searchsorted(series.time, self._passed, side="right"))
        self.statistics.late += late
        self.statistics.covered += int(np.count_nonzero(np.diff(series.time[late:]) == 0))
        return series[late:]

    def _columns(self, series: Series, rows: NDArray[np.intp], time: FloatArray) -> dict[str, FloatArray]:
        """The series' signals at all rows; `rows` says at which its samples are."""
        newest = _newest(rows, len(time))
        columns = {}
        for name, values in series.values.items():
            finite = np.isfinite(values)
            if finite.all():
                own, at, last = values, series.time, newest
            else:
                own, at, last = values[finite], series.time[finite], _newest(rows[finite], len(time))
            if name not in self.signals or not len(own):
                continue
            columns[name] = (
                self._between(name, own, at, time) if name in self.interpolated else self._hold(name, own, last)
            )
            self._held[name] = float(own[-1])
        return columns

    def _hold(self, name: str, values: FloatArray, newest: NDArray[np.intp]) -> FloatArray:
        if newest[0] >= 0:
            return values[newest]
        return np.concatenate((values, [self._held.get(name, np.nan)]))[newest]  # -1 is the last: what was held

    def _between(self, name: str, values: FloatArray, at: FloatArray, time: FloatArray) -> FloatArray:
        distinct = np.append(at[1:] > at[:-1], True)
        left = self._held.get(name, np.nan)
        return np.asarray(np.interp(time, at[distinct], values[distinct], left=left), np.float64)


def _union(times: Iterable[FloatArray]) -> tuple[FloatArray, list[NDArray[np.intp]]]:
    """All distinct stamps, ascending, and for each of the ascending columns the rows of its stamps among them."""
    columns = list(times)
    if not columns:
        return np.empty(0), []
    together = np.concatenate(columns)
    order = np.argsort(together, kind="stable")
    sorted_times = together[order]
    new = np.concatenate(([True], sorted_times[1:] > sorted_times[:-1]))
    rows = np.empty(len(together), dtype=np.intp)
    rows[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(column) for column in columns])
    return sorted_times[new], np.split(rows, ends[:-1])


def _newest(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """(count,) the number of the newest sample at each row, -1 before the first; `rows` (K,) ascend, one a sample."""
    newest = np.full(count, -1, dtype=np.intp)
    newest[rows] = np.arange(len(rows))
    return np.maximum.accumulate(newest)


@dataclass
class LateBegins:
    """From when on the signals of a trace, told piece by piece, have values.

    Attributes:
        rows: of the pieces so far.
        begins: signal -> rows before its first value, and when that was [s].
    """

    rows: int = 0
    begins: dict[str, tuple[int, float]] = field(default_factory=dict)

    def feed(self, piece: Trace) -> None:
        """Look at this piece, too."""
        for name in piece.names:
            if name not in self.begins and len(found := np.flatnonzero(np.isfinite(piece[name]))):
                self.begins[name] = self.rows + int(found[0]), float(piece.time[found[0]])
        self.rows += len(piece)

    def lines(self) -> list[str]:
        """A line for each signal that comes so late that more than a hundredth of the rows is empty before."""
        return [
            f"{name} is first seen at {time:.6g} s: it is empty in the {count} of {self.rows} rows before"
            for name, (count, time) in self.begins.items()
            if count > 0.01 * self.rows
        ]
