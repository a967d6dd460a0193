"""Where segments begin before anything is known, and whether a run may be cut at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fmus.errors import FmuError, IdentificationError
from identification.estimation.groups import own_values
from identification.estimation.workers import Pool, SimulationTask
from identification.output_error.search.problem import Problem
from identification.output_error.search.work import spread
from identification.output_error.shooting.shots import Shots
from orchestrator.trace import FloatArray

_PARTED = 1e-2  # of an output's spread or a state's size: by how much a run that was cut may differ


def guessed(shots: Shots, problem: Problem, pool: Pool) -> FloatArray:
    """(W, count, s) start values: those that the recordings tell, else where the segment before ends."""
    guesses = shots.guesses.copy()
    for j in range(1, shots.count if np.isnan(guesses).any() else 0):
        rows = [w * shots.count + j - 1 for w in range(len(guesses))]
        ends = _ends(_run(shots, problem, pool, rows, guesses[:, j - 1]), guesses[:, j - 1])
        guesses[:, j] = np.where(np.isnan(guesses[:, j]), ends, guesses[:, j])
    return guesses


def require_whole(shots: Shots, problem: Problem, pool: Pool, guesses: FloatArray) -> None:
    """See that the first two segments of each window, the second from where the first ends, are the run of both.

    Raises:
        IdentificationError: they are not, as a component remembers more than the states that are set.
    """
    firsts = [w * shots.count for w in range(len(guesses))]
    pairs = [len(guesses) * shots.count + w for w in range(len(guesses))]
    first = _run(shots, problem, pool, firsts, guesses[:, 0])
    second = _run(shots, problem, pool, [row + 1 for row in firsts], _ends(first, guesses[:, 1]))
    whole = _run(shots, problem, pool, pairs, guesses[:, 0])
    sizes, moving = np.abs(guesses).max(axis=(0, 1)), spread(problem)
    for w, (begun, rest, both) in enumerate(zip(first, second, whole, strict=True)):
        if begun is None or rest is None or both is None:
            continue  # a run that leaves the recordings tells nothing of that
        own, window = shots.windows[firsts[w] + 1], problem.windows[w]
        later = (own.start - shots.windows[pairs[w]].start) / float(own.step) + own.at[0]
        offset = int(np.argmin(np.abs(shots.windows[pairs[w]].at - later)))
        apart = np.abs(rest - both[offset : offset + len(rest)])
        outputs = (window.weight * apart[:, : -len(sizes)]).max(axis=0) / moving
        states = np.divide(apart[-1, -len(sizes) :], sizes, out=np.zeros(len(sizes)), where=sizes > 0)
        off = np.concatenate([outputs, states])
        if off.max() > _PARTED:
            name = [*problem.outputs, *(state.shown for state in shots.states)][int(off.argmax())]
            raise IdentificationError(
                shots.key,
                f"cannot cut {window.name}: from there on {name} is {off.max():.2g} of its size elsewhere",
                f"leave it out; more is remembered than {', '.join(state.start for state in shots.states)}",
            )


def _run(
    shots: Shots, problem: Problem, pool: Pool, rows: Sequence[int], starts: FloatArray
) -> list[FloatArray | None]:
    """What these segments show, from start values (R, s) and with parameters at their start; None where one fails."""
    known = problem.parameters.values(np.zeros(len(problem.parameters.free)))
    tasks = []
    for row, own in zip(rows, starts, strict=True):
        values = own_values(problem.grouped, shots.windows[row].trace, known)
        begun = zip((state.start for state in shots.states), own.tolist(), strict=True)
        tasks.append(SimulationTask(row, values | dict(begun)))
    found = pool.run(tasks)
    return [None if one is None or isinstance(one, FmuError) or not np.isfinite(one).all() else one for one in found]


def _ends(found: Sequence[FloatArray | None], otherwise: FloatArray) -> FloatArray:
    """(R, s) where segments end; of those that failed others (R, s)."""
    s = otherwise.shape[1]
    return np.array([other if one is None else one[-1, -s:] for one, other in zip(found, otherwise, strict=True)])
