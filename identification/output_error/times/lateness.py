"""Whether residuals look as if outputs were recorded later, or earlier, than the free runs have them.

A delay is tried as one more unknown of the linearised fit: what of it parameters and start values cannot make up for is
held against the residuals. So nothing needs to be simulated again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from identification.estimation.arrow_least_squares import WindowBlock
from identification.estimation.uncertainty import UNSEEN, Covariance, covariance, without
from orchestrator.trace import FloatArray

if TYPE_CHECKING:
    from identification.output_error.search.problem import Problem

_CERTAIN = 4.0  # standard deviations
_MOVED = 1.0  # standard deviations of an estimate, from which it is worth a word
_EXPLAINED = 0.1  # of residuals that are not white without it either, from which it is likely what is wrong
_SEEN = 1e-2  # of a delay's column: what parameters have to leave of it


@dataclass(frozen=True)
class OutputLateness:
    """How late outputs are, as residuals speak for it.

    Attributes:
        outputs: those that are.
        steps, std: how late, and how surely; negative where they are early.
        explained: share of the residuals' power.
        moved: parameter -> by how many of its standard deviations the estimate goes with it.
    """

    outputs: tuple[str, ...]
    steps: float
    std: float
    explained: float
    moved: Mapping[str, float]


def lateness(
    problem: Problem,
    blocks: Sequence[WindowBlock],
    uncertainty: Covariance,
    before: WindowBlock | None = None,
    noise: float = 1.0,
) -> OutputLateness | None:
    """The one that explains most of the residuals, of each output and of all; None where none does for certain, or
    where it moves no estimate by more than its standard deviation.

    Args:
        blocks: the windows linearised at the estimate; of segments of them nothing is told.
        before, noise: what is known before as rows, in standard deviations times that noise.
    """
    whole = [len(block.residual) for block in blocks] == [window.measured.size for window in problem.windows]
    if not (problem.parameters.free and whole):
        return None
    fit = _DelayTrial(problem, blocks, uncertainty, before, noise)
    found = [one for outputs, delayed in _delayed(problem, blocks) if (one := fit.tried(outputs, delayed)) is not None]
    return max(found, key=lambda one: one.explained, default=None)


def _delayed(problem: Problem, blocks: Sequence[WindowBlock]) -> Iterator[tuple[tuple[str, ...], list[FloatArray]]]:
    """Outputs, and by how much a window's residuals (K m,) go with their delay by a step."""
    count, slopes = len(problem.outputs), []
    for window, block in zip(problem.windows, blocks, strict=True):
        weighted = window.weight * window.measured + block.residual.reshape(window.measured.shape)
        slopes.append(-np.gradient(weighted, window.steps, axis=0))
    for own in [*np.eye(count), *([np.ones(count)] if count > 1 else [])]:
        names = tuple(name for name, kept in zip(problem.outputs, own, strict=True) if kept)
        yield names, [(own * slope).ravel() for slope in slopes]


class _DelayTrial:
    """The linearised fit, start values projected out, with what is known before as rows below the windows'."""

    def __init__(
        self,
        problem: Problem,
        blocks: Sequence[WindowBlock],
        uncertainty: Covariance,
        before: WindowBlock | None,
        noise: float,
    ) -> None:
        self._problem, self._windows, self._noise = problem, blocks, noise
        self._before = [] if before is None else [before]
        self._std = np.sqrt(np.diag(uncertainty.matrix))
        jacobian = np.concatenate([without(block.parameters, block.states) for block in [*blocks, *self._before]])
        lengths = np.linalg.norm(jacobian, axis=0)
        scaled = jacobian / np.where(lengths > 0, lengths, 1.0)
        left, values, right = np.linalg.svd(scaled, full_matrices=False)
        seen = values > UNSEEN * values.max(initial=0.0)
        self._basis, self._lengths = left[:, seen], np.where(lengths > 0, lengths, np.inf)
        self._inverse = right[seen].T / values[seen] @ left[:, seen].T
        off = np.concatenate([np.zeros(0), *(block.residual for block in self._before)])
        self._residual = self._rest(self._of_all([problem.loss.influence(block.residual) for block in blocks], off))

    def tried(self, outputs: tuple[str, ...], delayed: Sequence[FloatArray]) -> OutputLateness | None:
        """What residuals say of a delay, for certain."""
        column = self._of_all(delayed, np.zeros(sum(len(block.residual) for block in self._before)))
        own = self._rest(column)
        power = float(own @ own)
        if not power > _SEEN**2 * sum(float(one @ one) for one in delayed):
            return None
        steps = -float(own @ self._residual) / power
        left = self._residual + steps * own
        moved = self._moved(-steps * column)
        if abs(steps) < _CERTAIN * float(np.std(left)) / np.sqrt(power) or max(map(abs, moved.values())) < _MOVED:
            return None
        explained = 1 - float(left @ left) / float(self._residual @ self._residual)
        found = self._covariance(delayed, left)
        std = float(np.sqrt(found.matrix[-1, -1]))
        likely = explained > _EXPLAINED or found.is_white
        return OutputLateness(outputs, steps, std, explained, moved) if likely and abs(steps) > _CERTAIN * std else None

    def _of_all(self, columns: Sequence[FloatArray], before: FloatArray) -> FloatArray:
        """(N,) what start values do not explain of windows' columns (K m,), and below that of what is known before."""
        pairs = zip(columns, self._windows, strict=True)
        parts = [without(column[:, None], block.states)[:, 0] for column, block in pairs]
        return np.concatenate([*parts, before])

    def _rest(self, column: FloatArray) -> FloatArray:
        return np.asarray(column - self._basis @ (self._basis.T @ column))

    def _moved(self, column: FloatArray) -> dict[str, float]:
        steps = self._inverse @ column / self._lengths
        known = np.isfinite(self._std) & (self._std > 0)
        shares = np.divide(steps, self._std, out=np.zeros(len(steps)), where=known)
        return dict(zip((one.name for one in self._problem.parameters.free), shares.tolist(), strict=True))

    def _covariance(self, delayed: Sequence[FloatArray], left: FloatArray) -> Covariance:
        """Of the parameters and, last, a delay [steps] that leaves these residuals."""
        ends = np.cumsum([len(block.residual) for block in self._windows])
        triples = zip(self._windows, np.split(left, ends), delayed, strict=False)
        blocks = [
            replace(block, residual=rest, parameters=np.column_stack([block.parameters, column]))
            for block, rest, column in triples
        ]
        rows = [
            replace(one, parameters=np.column_stack([one.parameters, np.zeros(len(one.residual))]))
            for one in self._before
        ]
        outputs, known = len(self._problem.outputs), next(iter(rows), None)
        found = covariance(blocks, self._problem.loss, outputs, before=known, noise=self._noise)
        return found.repeated(self._problem.counted)
