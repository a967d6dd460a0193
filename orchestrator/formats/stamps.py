"""Time stamps with a date: seconds since the first, and when that was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute

from fmus.errors import TraceError
from orchestrator.formats.recording import excerpt
from orchestrator.trace import FloatArray


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


def since_first(instants: NDArray[np.int64], zone: str | None, place: Path, notes: tuple[str, ...] = ()) -> Stamps:
    """Instants (K,) [ns since 1970] on clocks of a time zone; without one they are taken as UTC.

    Raises:
        TraceError: no such zone, or clocks were changed there and then.
    """
    if zone is None:
        notes = (*notes, "its times name no zone and are taken as UTC (`time_zone` in the layout)")
    elif zone != "UTC":
        instants = _utc(instants, zone, place)
    return Stamps((instants - instants[0]) / 1e9, float(instants[0] / 1e9), notes)


def _utc(instants: NDArray[np.int64], zone: str, place: Path) -> NDArray[np.int64]:
    try:
        known = compute.assume_timezone(pa.array(instants).cast(pa.timestamp("ns")), zone)
    except (pa.ArrowInvalid, OSError) as problem:
        raise TraceError(
            place, f"its times are none of `time_zone: {zone}` ({excerpt(problem)})", "say one such as Europe/Berlin"
        ) from None
    return np.asarray(known.cast(pa.int64()).to_numpy(), dtype=np.int64)
