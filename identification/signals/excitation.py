"""Where recordings move: how long stretches have to be so that something happens in them, and in which it does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from identification.signals.processing import dominant_frequency
from orchestrator.trace import Trace

PERIODS = 4  # of the strongest oscillation, that a stretch is long
_SHORTEST, _PARTS = 50, 4  # communication steps of one at least; how many fit into the shortest recording at least
STILL = 0.1  # of its spread over all recordings, below which a signal does not move


@dataclass(frozen=True)
class Length:
    """How long stretches are [s], and the period of the recordings' strongest oscillation, their median [s]."""

    seconds: Fraction
    period: float


@dataclass(frozen=True)
class Picked:
    """What became of a recording's stretches: how many are taken, are still, or move less than so many others."""

    taken: int
    still: int
    less: int


def stretch_length(traces: Sequence[Trace], signals: Sequence[str], step: Fraction, skip: Fraction) -> Length:
    """Some periods of the strongest oscillation, within what recordings are long; a multiple of `step` [s].

    Args:
        signals: those that are compared.
        skip: what is left out at the beginning of each recording [s].
    """
    periods = [_period(trace, signal, float(step)) for trace in traces for signal in signals]
    period = float(np.median(periods))
    room = min(trace.duration for trace in traces) - float(skip)
    shortest = min(_SHORTEST * float(step), room)
    seconds = max(shortest, min(PERIODS * period, room / _PARTS))
    return Length(max(int(seconds / float(step) + 1e-9), 1) * step, period)


def _period(trace: Trace, signal: str, step: float) -> float:
    """Of a signal's strongest oscillation [s]; the whole recording where nothing moves."""
    raster = np.arange(trace.time[0], trace.time[-1], step)
    values = np.interp(raster, trace.time, trace[signal])
    frequency = dominant_frequency(values, step) if len(raster) > 3 else 0.0
    return 2 * np.pi / frequency if frequency > 0 else trace.duration


def spreads(traces: Iterable[Trace], signals: Iterable[str]) -> dict[str, float]:
    """Signal -> its standard deviation over all recordings."""
    known = list(traces)
    return {signal: float(np.concatenate([trace[signal] for trace in known]).std()) for signal in signals}


def motion(trace: Trace, start: float, stop: float, spread: Mapping[str, float]) -> dict[str, float]:
    """Signal -> how much it moves from start to stop [s], as a share of its spread."""
    part = trace.between(start, stop)
    return {
        signal: float(part[signal].std()) / size if size > 0 and len(part) else 0.0 for signal, size in spread.items()
    }


def most_moving(scores: Sequence[float], moves: Sequence[bool], most: int | None) -> tuple[list[int], Picked]:
    """Which stretches of a recording are taken, in their order, and what became of all.

    Args:
        scores: how much happens in each.
        moves: whether anything does.
        most: how many are taken at most.
    """
    moving = [number for number, move in enumerate(moves) if move]
    ranked = sorted(moving, key=lambda number: -scores[number])
    taken = sorted(ranked[:most])
    return taken, Picked(len(taken), len(scores) - len(moving), len(moving) - len(taken))
