"""Time stamps with a date: seconds since the first, and when that was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.trace import FloatArray

Instants = NDArray[np.int64]
HOUR = 3600 * 10**9  # [ns]


@dataclass(frozen=True)
class Stamps:
    """Times since the first sample.

    Attributes:
        time: (K,) [s].
        start: POSIX time of the first [s], where it is known.
        notes: what was assumed, a line each.
    """

    time: FloatArray
    start: float | None = None
    notes: tuple[str, ...] = ()


def since_first(instants: Instants, zone: str | None, place: Path, notes: tuple[str, ...] = ()) -> Stamps:
    """Instants (K,) [ns since 1970] on clocks of a time zone; without one they are taken as UTC.

    Raises:
        TraceError: no such zone, or clocks were changed there and then.
    """
    if zone is None:
        _refuse_put_back(instants, place)
        notes = (*notes, "its times name no zone and are taken as UTC (`time_zone` in the layout)")
    elif zone != "UTC":
        instants, seen = _utc(instants, zone, place)
        notes = (*notes, *seen)
    return Stamps((instants - instants[0]) / 1e9, float(instants[0] / 1e9), notes)


def _refuse_put_back(instants: Instants, place: Path) -> None:
    """See that no clock was put back by an hour: without its zone nobody can tell what came when."""
    steps = np.diff(instants)
    back = np.flatnonzero((steps < 0) & (steps >= -HOUR) & (steps + HOUR <= 20 * np.median(np.abs(steps))))
    if len(back):
        problem = f"its times go back by an hour at sample {back[0] + 2}, as clocks are put back"
        raise TraceError(place, problem, "say `time_zone` in the layout, such as Europe/Berlin")


def _utc(local: Instants, zone: str, place: Path) -> tuple[Instants, tuple[str, ...]]:
    """Instants in UTC, and what was seen: the order tells those apart that come twice as clocks are put back."""
    early, late = (_assumed(local, zone, which, place) for which in ("earliest", "latest"))
    if np.array_equal(early, late):
        return early, ()
    back = np.flatnonzero(np.diff(local) < 0)
    if len(back) != 1 or not np.all((early != late)[[back[0], back[0] + 1]]):
        problem = f"some of its times come twice in {zone}, as clocks are put back"
        raise TraceError(place, problem, "write them with their offset, as 02:10:00+01:00")
    known = np.where(np.arange(len(local)) > back[0], late, early)
    return known, (f"clocks are put back at sample {back[0] + 1}",)


def _assumed(local: Instants, zone: str, which: Literal["earliest", "latest"], place: Path) -> Instants:
    import pyarrow as pa  # noqa: PLC0415 - loads slowly
    from pyarrow import compute  # noqa: PLC0415 - loads slowly

    try:
        known = compute.assume_timezone(pa.array(local).cast(pa.timestamp("ns")), zone, ambiguous=which)
    except (pa.ArrowInvalid, OSError) as problem:
        raise TraceError(
            place, f"its times are none of `time_zone: {zone}` ({excerpt(problem)})", "say one such as Europe/Berlin"
        ) from None
    return np.asarray(known.cast(pa.int64()).to_numpy(), dtype=np.int64)
