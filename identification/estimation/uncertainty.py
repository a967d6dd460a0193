"""What data say about parameters, and what they do not: covariance, intervals, identifiability.

Everything starts from the windows' Jacobians with the estimated initial states projected out, so that their
uncertainty is part of the parameters'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth, qr
from scipy.special import stdtrit

from identification.estimation.arrow_least_squares import Loss, WindowBlock
from identification.estimation.noise import Noise, coloured, white
from identification.estimation.parameters import Parameter
from identification.estimation.remedies import separating
from identification.estimation.validation import Whiteness, whiteness
from orchestrator.trace import FloatArray, ReadOnlyArrays

CovarianceMethod = Literal["white", "coloured", "window", "none"]
UNSEEN, WEAK = 1e-4, 1e-2
_FEWEST_WINDOWS = 10
_NO_EFFECT = 1e-9
_KNOWN = 1e-9  # what is seen of combinations that are known before


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


@dataclass(frozen=True, eq=False)
class Covariance(ReadOnlyArrays):
    """Uncertainty of an estimate in z.

    Attributes:
        matrices: method -> (n, n), see `covariance`; an undetermined parameter has inf on the diagonal and nan
            beside it. "window" is missing when the windows are too few.
        method: the one that `matrix` is by.
        freedom: degrees of freedom of the t distribution for intervals.
        states: (W, s) standard deviations of the initial states in z.
        whiteness: one test an output.
        samples_each: (m,) how many samples of an output's residual tell as much as one of white noise.
        curvature: (n, n) inverse of the cost's curvature by the parameters, the states fitted; 0 where nothing is seen.
        stretch: (n,) what the rise of the cost along each parameter is divided by: the variance of white residuals
            where they are, more where they are correlated; of what is not seen the largest of the others.
        deleted: (W, n) change of the estimate in z as each window is left out, to first order; None where windows are
            too few or one alone sees a parameter.
    """

    matrices: Mapping[CovarianceMethod, FloatArray]
    method: CovarianceMethod
    freedom: int
    states: FloatArray
    whiteness: tuple[Whiteness, ...]
    samples_each: FloatArray
    curvature: FloatArray
    stretch: FloatArray
    deleted: FloatArray | None = None

    @property
    def matrix(self) -> FloatArray:
        """(n, n) by the chosen method."""
        return self.matrices[self.method]

    @property
    def is_white(self) -> bool:
        """True when no output's residuals are rejected as white."""
        return all(test.white for test in self.whiteness)

    @property
    def quantile(self) -> float:
        """t quantile of a two-sided 95 % interval."""
        return float(stdtrit(self.freedom, 0.975))


@dataclass(frozen=True, eq=False)
class _Rows:
    """A window's share of the estimating equations, the states projected out.

    Rows are scaled so that jacobian^T jacobian is the expected curvature of the loss and jacobian^T influence
    its gradient; `parameters` and `states` are the columns before the projection.
    """

    jacobian: FloatArray
    influence: FloatArray
    parameters: FloatArray
    states: FloatArray


def covariance(
    blocks: Sequence[WindowBlock],
    loss: Loss,
    outputs: int,
    rounding: FloatArray | None = None,
    before: WindowBlock | None = None,
    noise: float = 1.0,
) -> Covariance:
    """Covariance of the parameters from central-difference blocks at the estimate.

    Args:
        rounding: (m,) variance of the outputs' rounding, in the residuals' units, below which no noise is taken to be.
        before: what is known before of parameters as rows (p,), in standard deviations times `noise`.

    "white": H^-1 (sum of J_w^T N J_w) H^-1 with N = S at every instant, S the (m, m) covariance of the outputs'
    noise; for one output and least squares this is s^2 (J^T J)^-1. Right when residuals are white; those of a
    model with errors are not.

    "coloured": the same with N the covariance of an autoregression fitted to the residuals. Right when the noise
    is one stationary process in all windows.

    "window": the delete-one-window jackknife, sum of d_w d_w^T (W - 1) / W with d_w the change of the
    estimate when window w is left out (a cluster sandwich). Right when windows are independent of each other,
    whatever happens inside them.

    "white" is chosen unless whiteness is rejected at 1 %; then "window" with enough windows, else "coloured".
    With a robust loss residuals count by their influence and H by the mean curvature (Huber 1981). The
    deviations of the states include the parameters' uncertainty; their own share is for white or coloured noise.

    Source: MacKinnon, Nielsen and Webb 2023 (CV3).
    """
    rows = _projected(blocks, loss, outputs)
    if before is not None:
        rows = _seen_only(blocks, rows)
    transform, lost = _whitening(blocks, rows, before)
    unknowns = transform.shape[1] + blocks[0].states.shape[1] * len(blocks)
    influences = [row.influence for row in rows]
    freedom = max(sum(map(len, influences)) - unknowns, 1)
    fitted = [np.column_stack([basis(row.states), row.jacobian @ transform]) for row in rows]
    flat, correlated = white(influences, outputs, freedom), coloured(influences, outputs, fitted)
    if rounding is not None:
        flat, correlated = flat.at_least(rounding), correlated.at_least(rounding)
    tests = tuple(whiteness([b.residual.reshape(-1, outputs)[:, i] for b in blocks]) for i in range(outputs))
    drawn = _scatter_before(before, transform, noise**2)
    found: dict[CovarianceMethod, FloatArray] = {
        "white": _stationary(rows, transform, flat) + drawn,
        "coloured": _stationary(rows, transform, correlated) + drawn,
    }
    deleted = _deleted(rows, transform)
    if deleted is not None:
        centred = deleted - deleted.mean(axis=0)
        found["window"] = centred.T @ centred * (len(rows) - 1) / len(rows) + drawn
    matrices = {name: marked(matrix, lost) for name, matrix in found.items()}
    is_white = all(test.white for test in tests)
    method: CovarianceMethod = "white" if is_white else "coloured" if deleted is None else "window"
    return Covariance(
        matrices=matrices,
        method=method,
        freedom=len(blocks) - 1 if method == "window" else freedom,
        states=_state_deviations(rows, transform, matrices[method], flat if is_white else correlated),
        whiteness=tests,
        samples_each=correlated.samples_each,
        curvature=transform @ transform.T,
        stretch=_stretch(found[method], transform @ transform.T, float(np.trace(flat.covariance)) / outputs),
        deleted=deleted,
    )


def _stretch(matrix: FloatArray, curvature: FloatArray, noise: float) -> FloatArray:
    """(n,) variance of each parameter over what noise of variance 1 would give."""
    own = np.diag(curvature)
    ratios = np.divide(np.diag(matrix), own, out=np.zeros(len(own)), where=own > 0)
    return np.where(own > 0, ratios, ratios.max(initial=0.0) or noise)


def no_covariance(residuals: Sequence[FloatArray], n: int, states: int, outputs: int) -> Covariance:
    """That of an estimate without Jacobian: nothing is determined.

    Args:
        residuals: (K m,) a window.
        n: free parameters.
        states: estimated initial states of a window.
    """
    matrix = np.where(np.eye(n, dtype=bool), np.inf, np.nan)
    tests = tuple(whiteness([r.reshape(-1, outputs)[:, i] for r in residuals]) for i in range(outputs))
    nothing, each, flat = np.full((len(residuals), states), np.inf), np.ones(outputs), np.zeros((n, n))
    return Covariance({"none": matrix}, "none", 1, nothing, tests, each, flat, np.full(n, np.inf))


def _curvature(blocks: Sequence[WindowBlock], loss: Loss, outputs: int) -> FloatArray:
    """(m,) mean curvature of the loss for each output, kept positive."""
    curvatures = np.concatenate([loss.curvature(block.residual).reshape(-1, outputs) for block in blocks])
    return np.asarray(np.maximum(curvatures.mean(axis=0), 0.05))


def _projected(blocks: Sequence[WindowBlock], loss: Loss, outputs: int) -> list[_Rows]:
    curvature, rows = _curvature(blocks, loss, outputs), []
    for block in blocks:
        root = np.tile(np.sqrt(curvature), len(block.residual) // outputs)
        parameters, states = block.parameters * root[:, None], block.states * root[:, None]
        rows.append(_Rows(without(parameters, states), loss.influence(block.residual) / root, parameters, states))
    return rows


def without(parameters: FloatArray, states: FloatArray) -> FloatArray:
    """(N, n) what of the parameters' columns (N, n) the states' columns (N, s) cannot explain."""
    spanned = basis(states)
    return np.asarray(parameters - spanned @ (spanned.T @ parameters))


def basis(columns: FloatArray) -> FloatArray:
    """(N, r) orthonormal columns that span these (N, n)."""
    return np.asarray(orth(columns, rcond=1e-10)) if columns.any() else np.zeros((len(columns), 0))


def _lengths(blocks: Sequence[WindowBlock]) -> FloatArray:
    return np.asarray(np.sqrt(sum(np.sum(block.parameters**2, axis=0) for block in blocks)))


def _decomposed(
    blocks: Sequence[WindowBlock], jacobians: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Column lengths (1 for one without effect), singular values and right vectors of the Jacobian."""
    lengths = _lengths(blocks)
    lengths = np.where(lengths > _NO_EFFECT * lengths.max(initial=0.0), lengths, np.inf)
    triangle = np.linalg.qr(np.vstack([np.linalg.qr(j, mode="r") for j in jacobians]), mode="r")
    _, values, right = np.linalg.svd(triangle / lengths)
    padded = np.zeros(len(lengths))
    padded[: len(values)] = values
    return np.where(np.isfinite(lengths), lengths, 1.0), padded, right.T


def _seen_only(blocks: Sequence[WindowBlock], rows: Sequence[_Rows]) -> list[_Rows]:
    """The rows without what lies along combinations that are not seen, which is rounding: priors may be as weak."""
    lengths, values, vectors = _decomposed(blocks, [row.jacobian for row in rows])
    hidden = vectors[:, values <= UNSEEN * values.max(initial=0.0)]
    projection = np.eye(len(lengths)) - (hidden / lengths[:, None]) @ (hidden * lengths[:, None]).T
    return [replace(row, jacobian=row.jacobian @ projection) for row in rows]


def _whitening(
    blocks: Sequence[WindowBlock], rows: Sequence[_Rows], before: WindowBlock | None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n, k) transform to k seen directions of unit curvature, and which parameters (n,) reach outside."""
    own = [] if before is None else [before]
    jacobians = [*(row.jacobian for row in rows), *(block.parameters for block in own)]
    lengths, values, vectors = _decomposed([*blocks, *own], jacobians)
    seen = values > (UNSEEN if before is None else _KNOWN) * values.max(initial=0.0)
    transform = vectors[:, seen] / values[seen] / lengths[:, None]
    return transform, np.asarray(np.sum(vectors[:, ~seen] ** 2, axis=1) > 1e-4)


def _scatter_before(before: WindowBlock | None, transform: FloatArray, variance: float) -> FloatArray:
    """(n, n) what the scatter of what is known before does to the estimate, as noise of that variance does."""
    seen = np.zeros((0, transform.shape[1])) if before is None else before.parameters @ transform
    return np.asarray(transform @ (variance * seen.T @ seen) @ transform.T)


def _stationary(rows: Sequence[_Rows], transform: FloatArray, noise: Noise) -> FloatArray:
    meat = np.zeros((transform.shape[1],) * 2)
    for row in rows:
        seen = row.jacobian @ transform
        meat += seen.T @ noise.times(seen)
    return transform @ meat @ transform.T


def fewest_windows(free: int) -> int:
    """How many windows have to be there so that they can be judged by each other, for so many free parameters."""
    return max(_FEWEST_WINDOWS, free + 5)


def _deleted(rows: Sequence[_Rows], transform: FloatArray) -> FloatArray | None:
    """(W, n) change of the estimate as each window is left out."""
    size = transform.shape[1]
    if len(rows) < fewest_windows(size):
        return None
    changes = []
    for row in rows:
        seen = row.jacobian @ transform
        rest = np.eye(size) - seen.T @ seen
        if size and np.linalg.eigvalsh(rest)[0] < 1e-6:
            return None
        changes.append(np.linalg.solve(rest, seen.T @ row.influence))
    return np.asarray(np.array(changes) @ transform.T)


def marked(matrix: FloatArray, lost: NDArray[np.bool_] | Sequence[int]) -> FloatArray:
    """A covariance (n, n) in which these parameters are not determined."""
    matrix = matrix.copy()
    matrix[lost, :] = matrix[:, lost] = np.nan
    matrix[lost, lost] = np.inf
    return matrix


def _state_deviations(rows: Sequence[_Rows], transform: FloatArray, matrix: FloatArray, noise: Noise) -> FloatArray:
    """(W, s) standard deviations: of ds = -A e - G dp with A the states' pseudo-inverse and G = A J_p."""
    parameters, inverse, deviations = np.where(np.isfinite(matrix), matrix, 0.0), transform @ transform.T, []
    for row in rows:
        own: FloatArray = np.asarray(np.linalg.pinv(row.states), dtype=float)
        gain, spread = own @ row.parameters, noise.times(own.T)
        shared = row.jacobian.T @ spread
        variance = np.sum(own.T * spread, axis=0) + np.sum(gain @ parameters * gain, axis=1)
        deviations.append(np.sqrt(np.maximum(variance - 2 * np.sum(gain @ inverse * shared.T, axis=1), 0.0)))
    return np.array(deviations)


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
    lengths, singular, vectors = _decomposed(blocks, jacobians)
    hidden = singular <= UNSEEN * singular.max()
    effects = _lengths(blocks)
    silent = effects <= _NO_EFFECT * effects.max()
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
