"""Windows cut into segments, each run freely from start values of its own, that show where they end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fmus.errors import IdentificationError
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.times.delays import compared_rows
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Segment(FreeRunWindow):
    """A part of a window; behind its compared outputs it has columns with the last value of each state.

    Attributes:
        ends: columns of its free run that are these states.
    """

    ends: tuple[int, ...] = ()

    def recorded(self, simulated: FloatArray, values: Mapping[str, float]) -> FloatArray:
        """(K', m + s) outputs as recorded, and in each row where the states (s,) end."""
        outputs = super().recorded(simulated[:, : len(self.delays)], values)
        last = simulated[-1, list(self.ends)]
        return np.column_stack([outputs, np.broadcast_to(last, (len(outputs), len(last)))])


def segments(window: FreeRunWindow, count: int, ends: tuple[int, ...], place: str) -> list[Segment]:
    """The window cut into so many, of equal lengths but for a step.

    A sample at a cut counts once, and those are left out that outputs with estimated delays show of the segment before.

    Raises:
        IdentificationError: too many, so that some would have fewer than two instants to compare.
    """
    cuts = instants(window, count)
    return [part(window, int(a), int(b), ends, place) for a, b in pairwise(cuts)]


def instants(window: FreeRunWindow, count: int) -> NDArray[np.int64]:
    """(count + 1,) instants of the window's free run between which its segments lie."""
    return np.linspace(0, window.count - 1, count + 1).round().astype(np.int64)


def part(window: FreeRunWindow, a: int, b: int, ends: tuple[int, ...], place: str) -> Segment:
    """The window from instant `a` to `b` of its free run, which itself is compared at the window's end alone."""
    at, reach = window.at - a, range(b - a + 1)[compared_rows(window.delays, window.step, b - a + 1)]
    within = (at >= reach[0]) & (at <= reach[-1]) if reach else np.zeros(len(at), np.bool_)
    kept = within & ((at < b - a) | (b == window.count - 1))
    if np.count_nonzero(kept) < 2:
        problem = f"leaves segments of {window.name} with {np.count_nonzero(kept)} instants to compare"
        raise IdentificationError(place, problem, "cut into fewer and longer ones")
    own = {field.name: getattr(window, field.name) for field in fields(FreeRunWindow)}
    changed = {
        "name": f"{window.name}, segment from {window.start + a * float(window.step):.4g} s",
        "measured": window.measured[kept],
        "start": window.start + a * float(window.step),
        "count": b - a + 1,
        "at": at[kept],
        "stimuli": {name: values[a : b + 1] for name, values in window.stimuli.items()},
        "readings": {} if a else window.readings,
    }
    return Segment(**{**own, **changed}, ends=ends)


def seen(segment: Segment, sizes: FloatArray) -> Segment:
    """The same as a window of a problem: its states (s,) are compared with 0, in their sizes."""
    nothing = np.zeros((len(segment.measured), len(sizes)))
    resolution = segment.resolution
    return replace(
        segment,
        measured=np.column_stack([segment.measured, nothing]),
        weight=np.concatenate([segment.weight, 1 / sizes]),
        resolution=None if resolution is None else np.concatenate([resolution, 0 * sizes]),
    )
