"""What data can tell apart at an estimate: combinations that are not seen, or hardly, and what would show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from identification.estimation.arrow_least_squares import WindowBlock
from identification.estimation.parameters import Parameter
from identification.estimation.remedies import separating
from identification.estimation.uncertainty import NO_EFFECT, UNSEEN, decomposed, lengths_of, without
from orchestrator.trace import FloatArray, ReadOnlyArrays

WEAK = 1e-2  # singular value, of the largest, below which combinations are seen hardly


@dataclass(frozen=True)
class Combination:
    """A direction in which parameters can move without the outputs following, or hardly.

    Attributes:
        coefficients: name -> change of the parameter [its unit], the largest relative change first.
        message: the same as a sentence.
        remedy: what would tell its parameters apart, or show a single one.
    """

    coefficients: dict[str, float]
    message: str
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class Identifiability(ReadOnlyArrays):
    """What the Jacobian at the estimate can and cannot tell apart.

    Attributes:
        names: the free parameters.
        singular_values: (n,) falling, of the Jacobian with the states projected out of columns of length 1.
        correlation: (n, n) of the estimates under white noise; nan where a parameter is not determined.
        unseen: the combinations whose singular value is below `UNSEEN` of the largest.
        weak: those of several parameters that are seen, but below `WEAK` of the largest.
    """

    names: tuple[str, ...]
    singular_values: FloatArray
    correlation: FloatArray
    unseen: tuple[Combination, ...]
    weak: tuple[Combination, ...] = ()

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; inf when something has no effect at all."""
        if not len(self.singular_values):
            return 1.0
        smallest = float(self.singular_values[-1])
        return float(self.singular_values[0]) / smallest if smallest > 0 else float("inf")


def identifiability(
    blocks: Sequence[WindowBlock], parameters: Sequence[Parameter], values: FloatArray, slopes: FloatArray
) -> Identifiability:
    """What the data can tell apart at the estimate.

    Args:
        blocks: central-difference Jacobians, in z.
        parameters: the free ones, in the blocks' order.
        values: (n,) estimates [unit each].
        slopes: (n,) d value / d z [unit each].
    """
    names = tuple(parameter.name for parameter in parameters)
    if not names:
        return Identifiability((), np.zeros(0), np.zeros((0, 0)), ())
    jacobians = [without(block.parameters, block.states) for block in blocks]
    lengths, singular, vectors = decomposed(blocks, jacobians)
    hidden = singular <= UNSEEN * singular.max()
    effects = lengths_of(blocks)
    silent = effects <= NO_EFFECT * effects.max()
    alone = [
        _alone(name, quiet, sum(i in b.unknown for b in blocks))
        for i, (name, quiet) in enumerate(zip(names, silent, strict=True))
    ]
    faint = ~hidden & (singular <= WEAK * singular.max())

    def named(v: FloatArray, only: str) -> Combination:
        return _combination(parameters, values, slopes, v / lengths, v, alone, only)

    unseen = [named(v, "only") for v in _sparse(vectors[:, hidden]).T]
    weak = [named(v, "hardly more than") for v in vectors[:, faint].T]
    inverse = vectors[:, ~hidden] / singular[~hidden]
    lost = np.sum(vectors[:, hidden] ** 2, axis=1) > 1e-4
    together = tuple(combination for combination in weak if len(combination.coefficients) > 1)
    return Identifiability(names, singular, _correlation(inverse @ inverse.T, lost), tuple(unseen), together)


def _sparse(basis: FloatArray) -> FloatArray:
    """Another basis (n, k) of the same space, each vector with a parameter of its own."""
    if not basis.shape[1]:
        return basis
    _, _, order = qr(basis.T, pivoting=True, mode="economic")
    return np.asarray(basis @ np.linalg.inv(basis[order[: basis.shape[1]]]))


def _combination(
    parameters: Sequence[Parameter],
    values: FloatArray,
    slopes: FloatArray,
    direction: FloatArray,
    effect: FloatArray,
    alone: Sequence[str],
    only: str,
) -> Combination:
    """The combination along a direction (n,) in z; `effect` (n,) is each entry's share in the outputs.

    `alone` is what to say of a parameter by itself, `only` how little else of several is seen.
    """
    involved = [int(i) for i in np.flatnonzero(np.abs(effect) > 0.02 * np.abs(effect).max())]
    moves = direction * slopes
    names = [parameters[i].name for i in involved]
    if len(involved) == 1:
        message = alone[involved[0]]
    elif len(involved) == 2:
        message = _pair([parameters[i] for i in involved], values[involved], direction[involved], moves[involved], only)
    else:
        message = _many(names, values[involved], moves[involved], only)
    told = [parameters[i] for i in involved]
    remedy = separating(told, _proportional(values[involved], moves[involved])) if len(told) > 1 else _showing(message)
    return Combination({parameters[i].name: float(moves[i]) for i in involved}, message, remedy)


def _showing(alone: str) -> str:
    """What would show a single parameter that is not seen."""
    if "initial states" in alone:
        return "longer windows, or windows that begin at rest (`estimated: false`)"
    if "failed" in alone:
        return "narrower `min` and `max`, where runs succeed"
    return "a recording of motion that depends on it, or `fixed: true`"


def _alone(name: str, silent: bool, failed: int) -> str:
    """Why a parameter is not seen; `failed` is in how many windows no run beside its estimate succeeded."""
    if failed:
        return f"{name} may have an effect or none: every run beside its estimate failed in {failed} windows"
    if silent:
        return f"{name} has no effect on the outputs"
    return f"{name} cannot be told from the estimated initial states"


def _pair(pair: Sequence[Parameter], values: FloatArray, direction: FloatArray, moves: FloatArray, only: str) -> str:
    (a, b), both = (pair[0].name, pair[1].name), f"{pair[0].name} and {pair[1].name}"
    if _proportional(values, moves):
        return f"{both}: {only} their ratio is seen"
    if all(parameter.scale == "log" for parameter in pair):
        power = -direction[0] / direction[1]
        return f"{both}: {only} a {'product' if power > 0 else 'ratio'} of them is seen, {a} * {b}^{power:.3g}"
    factor = -moves[0] / moves[1]
    kind, sign = ("sum", "+") if factor > 0 else ("difference", "-")
    return f"{both}: {only} a {kind} of them is seen, {a} {sign} {abs(factor):.3g} * {b}"


def _many(names: Sequence[str], values: FloatArray, moves: FloatArray, only: str) -> str:
    listed = ", ".join(names[:-1]) + f" and {names[-1]}"
    if _proportional(values, moves):
        return f"{listed}: {only} their ratios are seen"
    ratio = " : ".join(f"{move / np.abs(moves).max():.3g}" for move in moves)
    follow = "do not" if only == "only" else "hardly"
    return f"{listed}: the outputs {follow} follow when they move as {ratio}"


def _proportional(values: FloatArray, moves: FloatArray) -> bool:
    if np.any(values == 0):
        return False
    relative = moves / values
    return bool(np.ptp(relative) <= 0.01 * np.abs(relative).max())


def _correlation(matrix: FloatArray, lost: NDArray[np.bool_]) -> FloatArray:
    deviations = np.sqrt(np.where(lost, np.nan, np.diag(matrix)))
    return np.asarray(matrix / np.outer(deviations, deviations))
