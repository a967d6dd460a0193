"""The windows of a study in segments, with what joins these and where they start."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.shooting.segments import Segment, instants, part, segments
from identification.output_error.shooting.states import SettableState
from identification.output_error.study import OutputErrorStudy
from identification.output_error.windows import read_starts
from identification.recordings.campaign import StudyTrace
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Shots(ReadOnlyArrays):
    """Windows in segments.

    Attributes:
        key: of the study, for messages.
        states: what joins segments.
        count: segments of each window.
        windows: the segments, window by window; behind them the first two of each window in one.
        recorded: component.variable of what their free runs record.
        guesses: (W, count, s) start values; nan where that is best guessed from the segment before.
        fixed: of which states the first segment of each window has a value that is not estimated.
    """

    key: str
    states: tuple[SettableState, ...]
    count: int
    windows: tuple[Segment, ...]
    recorded: tuple[str, ...]
    guesses: FloatArray
    fixed: tuple[bool, ...]


def cut(
    study: OutputErrorStudy,
    windows: Sequence[FreeRunWindow],
    traces: Iterable[StudyTrace],
    states: Sequence[SettableState],
    ports: Mapping[str, Port],
) -> Shots | None:
    """The study's windows in segments; None where it asks for none.

    Args:
        traces: the recordings that windows are cut from.
        ports: as `cut_windows` takes them.

    Raises:
        IdentificationError: segments cannot be joined, or there are more constraints than data.
    """
    if study.shooting is None:
        return None
    key, count = study.shooting.key, max(study.shooting.count(window.stop) for window in windows)
    _check(study, count, windows, states)
    recorded = tuple(dict.fromkeys([*study.outputs, *(state.shown for state in states)]))
    ends = tuple(recorded.index(state.shown) for state in states)
    parts = [one for window in windows for one in segments(window, count, ends, key)]
    pairs = [part(window, 0, int(instants(window, count)[2]), ends, key) for window in windows]
    named = {recording.trace.name: recording for recording in traces}
    guesses = np.full((len(windows), count, len(states)), math.nan)
    for w, window in enumerate(windows):
        begins = [segment.start for segment in parts[w * count : (w + 1) * count]]
        for j, read in enumerate(read_starts(study.run, named[window.trace], begins, ports)):
            guesses[w, j] = [read.get(state.start, math.nan) for state in states]
        first = {**window.constants, **window.initial}
        guesses[w, 0] = [float(first.get(state.start, state.value)) for state in states]
    estimated = {name for name, spec in study.run.initial.items() if spec.estimated}
    fixed = tuple(state.start not in estimated for state in states)
    return Shots(key, tuple(states), count, (*parts, *pairs), recorded, guesses, fixed)


def _check(
    study: OutputErrorStudy, count: int, windows: Sequence[FreeRunWindow], states: Sequence[SettableState]
) -> None:
    """See that the study's windows can be cut and joined."""
    assert study.shooting is not None
    key, known = study.shooting.key, [state.start for state in states]
    there = ", ".join(known) or "none"
    if not states:
        raise IdentificationError("shooting", "finds no state that can be set and seen", "leave it out")
    for name in study.run.initial:
        if name not in known:
            problem = f"is no start value whose state can be seen; there are {there}"
            raise IdentificationError(f"initial.{name}", problem, "leave `shooting` out")
    for name in study.parameters.names:
        if study.variable(name) in known:
            fix = f"write it under `initial`, with `estimated: true`, instead of `parameters.{name}`"
            raise IdentificationError("shooting", f"estimates {name} in each segment", fix)
    if count < 2:
        raise IdentificationError(key, "is no shorter than the windows, which it cuts", "shorten it")
    constraints, data = len(windows) * (count - 1) * len(states), sum(window.measured.size for window in windows)
    if constraints >= data:
        made = f"makes {constraints} constraints ({count} segments a window, {len(states)} states)"
        raise IdentificationError(key, f"{made} for {data} samples", "cut into fewer and longer segments")
