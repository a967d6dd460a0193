"""The one data type that flows everywhere: named signals with units over time stamps.

A `Trace` is immutable, down to its numbers, and its stamps increase strictly. Recordings whose stamps repeat or run
backwards become one through `stamps.ordered`, which says what it had to do.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmus.errors import InputError, TraceError
from fmus.files import absence
from fmus.words import listed

if TYPE_CHECKING:
    import pandas
    import plotly.graph_objects as go

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
Bytes = NDArray[np.uint8]


def read_only(values: ArrayLike) -> FloatArray:
    """The values as an array that nobody can write: the same array where that is so already, else a copy."""
    array = np.asarray(values, dtype=float, order="C")
    if not _fixed(array):
        if array is values or array.base is not None:
            array = array.copy()
        array.flags.writeable = False
    return array


class ReadOnlyArrays:
    """Base of frozen dataclasses over arrays: nobody can write these, alone or in tuples and mappings.

    Such a dataclass is equal to itself alone (`eq=False`), since arrays have no one answer to `==`.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, _read_only(value))


def _read_only(value: object) -> object:
    if isinstance(value, np.ndarray) and value.dtype == float:
        return read_only(value)
    if type(value) is tuple and any(isinstance(entry, np.ndarray) for entry in value):
        return tuple(map(_read_only, value))
    if isinstance(value, dict) and any(isinstance(entry, np.ndarray) for entry in value.values()):
        return {key: _read_only(entry) for key, entry in value.items()}
    return value


def _fixed(array: object) -> bool:
    while isinstance(array, np.ndarray):
        if array.flags.writeable:
            return False
        array = array.base
    return True


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Signals sampled at common instants.

    Arrays are read-only: those that somebody could still write are copied. Traces are equal when all that they hold is,
    a missing sample (NaN) included.

    Attributes:
        time: (K,) strictly increasing stamps [s].
        signals: name -> (K,) samples, each in its own unit.
        units: name -> unit; a signal without an entry has no known unit.
        name: where it comes from, for messages and reports.
        texts: name -> the texts that the numbers of a signal stand for, from 0; only of those that hold text.
    """

    time: FloatArray
    signals: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = "trace"
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        signals = {key: read_only(values) for key, values in self.signals.items()}
        texts = {key: tuple(self.texts[key]) for key in signals if key in self.texts} if self.texts else {}
        object.__setattr__(self, "texts", MappingProxyType(texts))
        object.__setattr__(self, "time", read_only(self.time))
        object.__setattr__(self, "signals", MappingProxyType(signals))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))
        if self.time.ndim != 1:
            raise TraceError(self.name, f"time has shape {self.time.shape}, not (K,)", "give one stamp a sample")
        for key, values in signals.items():
            if values.shape != self.time.shape:
                raise TraceError(f"{self.name}.{key}", f"has shape {values.shape}, time has {self.time.shape}")
        if not np.all(np.isfinite(self.time)):
            raise TraceError(self.name, "a time stamp is not finite", "drop those rows")
        if np.any(self.time[1:] <= self.time[:-1]):
            raise TraceError(self.name, "stamps do not increase strictly", "pass the recording through `ordered`")

    def __len__(self) -> int:
        return len(self.time)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trace):
            return NotImplemented
        return (
            (self.name, self.names, self.units) == (other.name, other.names, other.units)
            and self.texts.keys() == other.texts.keys()
            and np.array_equal(self.time, other.time)
            and all(
                self.words(name) == other.words(name)
                if name in self.texts
                else np.array_equal(self[name], other[name], equal_nan=True)
                for name in self.names
            )
        )

    def __hash__(self) -> int:
        return hash((self.name, self.names, len(self), self.duration))

    def __reduce__(self) -> tuple[object, ...]:
        return Trace, (self.time, dict(self.signals), dict(self.units), self.name, dict(self.texts))

    def __repr__(self) -> str:
        return f"<Trace '{self.name}': {self._extent()}; {self._listed()}>"

    def _repr_html_(self) -> str:
        from orchestrator.display.table import table  # noqa: PLC0415

        rows = [
            (
                name,
                self.unit(name) or "",
                *((float(np.fmin.reduce(values)), float(np.fmax.reduce(values))) if len(self) else ()),
            )
            for name, values in self.signals.items()
            if name not in self.texts
        ]
        rows += [(name, "text", *self._ends(name)) for name in self.texts]
        headers = ("signal", "unit", "lowest", "highest") if len(self) else ("signal", "unit")
        return table(headers, rows, caption=f"{self.name}: {self._extent()}")

    def _ends(self, name: str) -> tuple[str, ...]:
        """The first text and the last one."""
        known = [text for text in self.words(name) if text is not None]
        return (known[0], known[-1]) if known else ("", "") if len(self) else ()

    def _extent(self) -> str:
        samples = f"{len(self):,} samples"
        return f"{samples}, {self.time[0]:g} to {self.time[-1]:g} s" if len(self) else samples

    def _listed(self, most: int = 6) -> str:
        known = [f"{name} [{self.units[name]}]" if name in self.units else name for name in self.names]
        return listed(known, most)

    def __getitem__(self, name: str) -> FloatArray:
        try:
            return self.signals[name]
        except KeyError:
            known = ", ".join(self.signals)
            raise TraceError(self.name, f"has no signal '{name}'", f"it holds {known}") from None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.signals)

    @property
    def duration(self) -> float:
        """From the first stamp to the last [s]."""
        return float(self.time[-1] - self.time[0]) if len(self) else 0.0

    @cached_property
    def interval(self) -> float:
        """From one sample to the next [s], the median where they differ; NaN where there are less than two."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else math.nan

    def unit(self, name: str) -> str | None:
        """Unit of a signal, None when it is not known."""
        return self.units.get(name)

    def words(self, name: str) -> list[str | None]:
        """(K,) the texts of a signal that holds text, None where a sample is missing."""
        known = self.texts[name]
        return [None if math.isnan(number) else known[int(number)] for number in self[name].tolist()]

    @property
    def numbers(self) -> Trace:
        """Without the signals that hold text."""
        return self.select(name for name in self.names if name not in self.texts) if self.texts else self

    def sampled(self, time: FloatArray, signals: Mapping[str, FloatArray]) -> Trace:
        """These samples instead, with what is known of signals of their names."""
        units = {name: unit for name, unit in self.units.items() if name in signals}
        return Trace(time, signals, units, self.name, self.texts)

    def select(self, names: Iterable[str]) -> Trace:
        """The same stamps with only these signals, in this order."""
        return self.sampled(self.time, {name: self[name] for name in names})

    def renamed(self, names: Mapping[str, str]) -> Trace:
        """Signals under new names (old -> new); the others keep theirs."""
        signals = {names.get(old, old): values for old, values in self.signals.items()}
        if len(signals) != len(self.signals):
            raise TraceError(self.name, "two signals would get one name", "choose distinct names")
        units = {names.get(old, old): unit for old, unit in self.units.items()}
        return Trace(self.time, signals, units, self.name, {names.get(old, old): t for old, t in self.texts.items()})

    def between(self, start: float, stop: float) -> Trace:
        """Samples with start <= t <= stop [s]; stamps keep their values."""
        first, last = np.searchsorted(self.time, [start, np.nextafter(stop, np.inf)])
        return self.rows(slice(int(first), int(last)))

    def complete(self) -> Trace:
        """Samples from where every signal has had a finite value."""
        finite = [np.flatnonzero(np.isfinite(values)) for values in self.signals.values()]
        return self.rows(slice(max((int(rows[0]) if len(rows) else len(self) for rows in finite), default=0), None))

    def covers(self, start: float, stop: float) -> bool:
        """Whether it lasts from `start` to `stop` [s], but for rounding."""
        return len(self) > 0 and bool(start >= self.time[0] - self._slack and stop <= self.time[-1] + self._slack)

    @property
    def _slack(self) -> float:
        return 1e-9 * max(1.0, self.duration)

    def shifted(self, offset: float) -> Trace:
        """The same samples with `offset` [s] added to every stamp."""
        return self.sampled(self.time + offset, self.signals)

    def resampled(self, time: ArrayLike, hold: Iterable[str] = ()) -> Trace:
        """Linear interpolation at `time` (K',) [s]; signals in `hold` and texts keep their last value instead.

        Raises:
            TraceError: an instant lies outside the recording (nothing is extrapolated).
        """
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        if len(self) == 0:
            raise TraceError(self.name, "has no samples", "choose a window inside the recording")
        if len(instants) and not self.covers(instants[0], instants[-1]):
            raise TraceError(
                self.name,
                f"covers {self.time[0]:g} to {self.time[-1]:g} s, not {instants[0]:g} to {instants[-1]:g} s",
                "shorten the window",
            )
        held = {*hold, *self.texts}
        rows = np.clip(np.searchsorted(self.time, instants + self._slack, side="right") - 1, 0, len(self) - 1)
        signals = {
            name: values[rows] if name in held else np.interp(instants, self.time, values)
            for name, values in self.signals.items()
        }
        return self.sampled(instants, signals)

    def to_pandas(self) -> pandas.DataFrame:
        """A frame with a column a signal over the index `time [s]`; units are in `attrs["units"]`.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas  # noqa: PLC0415 - optional
        except ImportError:
            raise InputError("to_pandas", "pandas is not installed", "pip install pandas") from None
        columns = {name: self.words(name) if name in self.texts else values for name, values in self.signals.items()}
        frame = pandas.DataFrame(columns, index=pandas.Index(self.time, name="time [s]"))
        frame.attrs["units"] = dict(self.units)
        return frame

    def plot(self) -> go.Figure:
        """A plotly figure with a window a signal above each other, of those that are numbers."""
        from orchestrator.display.curves import stacked  # noqa: PLC0415 - plotly loads slowly

        return stacked([(name, self.unit(name), self.time, values) for name, values in self.numbers.signals.items()])

    def rows(self, rows: slice | BoolArray) -> Trace:
        """Some of the samples."""
        signals = {name: values[rows] for name, values in self.signals.items()}
        return self.sampled(self.time[rows], signals)


def joined(pieces: Sequence[Trace]) -> Trace:
    """Pieces of one record, at least one, in a row; of texts the last piece knows all."""
    first = pieces[0]
    signals = {name: np.concatenate([piece[name] for piece in pieces]) for name in first.names}
    return Trace(np.concatenate([piece.time for piece in pieces]), signals, first.units, first.name, pieces[-1].texts)


def check_file(path: Path) -> None:
    """See that a recording is there and holds something.

    Raises:
        TraceError: it is not, is empty, or cannot be read.
    """
    if not path.is_file():
        raise TraceError(path, absence(path, "there is no such file"), "check the path")
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise TraceError(path, f"cannot be read ({error.strerror})", "check its permissions") from None
    if empty:
        raise TraceError(path, "is empty", "record or export it again")


def usable(trace: Trace, names: Sequence[str], resting: Collection[str] = (), fix: str = "") -> Trace:
    """The trace, once these signals are seen to be finite and not constant, but for those that may rest.

    Args:
        fix: what else there is to do about one that is constant.

    Raises:
        TraceError: there are no samples, or a signal is missing, has a NaN, or never changes.
    """
    if len(trace) == 0:
        raise TraceError(trace.name, "has no samples", "choose a window inside the recording")
    for name in names:
        values = trace[name]
        if name in trace.texts:
            raise TraceError(f"{trace.name}.{name}", "holds text, not numbers", "choose another signal")
        require_finite(trace, name)
        if name not in resting and np.all(values == values[0]):
            told = f"check the column's number{fix}"
            raise TraceError(f"{trace.name}.{name}", f"is constant ({values[0]:g})", told)
    return trace


def require_finite(trace: Trace, name: str, fix: str = "repair or cut the recording") -> None:
    """See that a signal has a value at each sample.

    Raises:
        TraceError: it has not; the message tells `fix`.
    """
    known = np.isfinite(trace[name])
    if known.all():
        return
    bad, begins = np.flatnonzero(~known), np.flatnonzero(known)[:1]
    late = f"; its first value comes at {trace.time[begins[0]]:g} s" if bad[0] == 0 and len(begins) else ""
    problem = f"is not finite at t = {trace.time[bad[0]]:g} s ({len(bad)} samples{late})"
    raise TraceError(f"{trace.name}.{name}", problem, fix)
