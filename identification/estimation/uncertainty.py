"""How uncertain estimates are: covariance and what intervals rest on.

Everything starts from the windows' Jacobians with the estimated initial states projected out, so that their
uncertainty is part of the parameters'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth
from scipy.special import stdtrit

from identification.estimation.arrow_least_squares import Loss, WindowBlock
from identification.estimation.noise import Coloured, Noise, White, coloured, white
from identification.estimation.validation import Whiteness, whiteness
from orchestrator.trace import FloatArray, ReadOnlyArrays

CovarianceMethod = Literal["white", "coloured", "window", "none"]
UNSEEN = 1e-4  # singular value, of the largest, below which nothing is seen
_FEWEST_WINDOWS = 10
NO_EFFECT = 1e-9  # length of a column, of the longest, below which its parameter has none
_KNOWN = 1e-9  # what is seen of combinations that are known before


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
        step: (n,) from the estimate to where slopes lead that no bound holds, in z; 0 but for rounding where none does.
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
    step: FloatArray
    deleted: FloatArray | None = None

    @property
    def matrix(self) -> FloatArray:
        """(n, n) by the chosen method."""
        return self.matrices[self.method]

    def repeated(self, times: float) -> Covariance:
        """The same where each sample is in so many windows: what scatters there is the same noise again."""
        matrices = {method: matrix * times for method, matrix in self.matrices.items()}
        freedom = max(round(self.freedom / times), 1)
        return replace(self, matrices=matrices, freedom=freedom, stretch=self.stretch * times)

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
    freedom = max(sum(len(row.influence) for row in rows) - unknowns, 1)
    flat, correlated = _noises(rows, transform, outputs, freedom, rounding)
    tests = tuple(whiteness([b.residual.reshape(-1, outputs)[:, i] for b in blocks]) for i in range(outputs))
    is_white = all(test.white for test in tests)
    deleted = _deleted(rows, transform)
    drawn = _scatter_before(before, transform, noise**2)
    found = {name: own + drawn for name, own in _by_method(rows, transform, flat, correlated, deleted).items()}
    matrices = {name: marked(matrix, lost) for name, matrix in found.items()}
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
        step=-transform @ (transform.T @ _gradient(rows, before)),
        deleted=deleted,
    )


def _noises(
    rows: Sequence[_Rows], transform: FloatArray, outputs: int, freedom: int, rounding: FloatArray | None
) -> tuple[White, Coloured]:
    """The white and the coloured model of what is left over, no smaller than its rounding."""
    influences = [row.influence for row in rows]
    fitted = [np.column_stack([basis(row.states), row.jacobian @ transform]) for row in rows]
    flat, correlated = white(influences, outputs, freedom), coloured(influences, outputs, fitted)
    return (flat, correlated) if rounding is None else (flat.at_least(rounding), correlated.at_least(rounding))


def _by_method(
    rows: Sequence[_Rows], transform: FloatArray, flat: White, correlated: Coloured, deleted: FloatArray | None
) -> dict[CovarianceMethod, FloatArray]:
    """Method -> (n, n), without the scatter of what is known before; by windows where these are enough."""
    found: dict[CovarianceMethod, FloatArray] = {
        "white": _stationary(rows, transform, flat),
        "coloured": _stationary(rows, transform, correlated),
    }
    if deleted is not None:
        centred = deleted - deleted.mean(axis=0)
        found["window"] = centred.T @ centred * (len(rows) - 1) / len(rows)
    return found


def _gradient(rows: Sequence[_Rows], before: WindowBlock | None) -> FloatArray:
    """(n,) of the cost by the parameters, the states fitted."""
    own = sum((row.jacobian.T @ row.influence for row in rows), np.zeros(rows[0].jacobian.shape[1]))
    return np.asarray(own if before is None else own + before.parameters.T @ before.residual)


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
    return Covariance({"none": matrix}, "none", 1, nothing, tests, each, flat, np.full(n, np.inf), np.zeros(n))


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


def growth(states: FloatArray) -> float:
    """How many times as much as in the first tenth of a window (N, s) its start values do later on; 0 where nothing."""
    if not states.any():
        return 0.0
    first = np.abs(states[: max(len(states) // 10, 1)]).max(axis=0)
    return float(np.divide(np.abs(states).max(axis=0), first, out=np.zeros(states.shape[1]), where=first > 0).max())


def lengths_of(blocks: Sequence[WindowBlock]) -> FloatArray:
    """(n,) length of each parameter's column."""
    return np.asarray(np.sqrt(sum(np.sum(block.parameters**2, axis=0) for block in blocks)))


def decomposed(
    blocks: Sequence[WindowBlock], jacobians: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Column lengths (1 for one without effect), singular values and right vectors of the Jacobian."""
    lengths = lengths_of(blocks)
    lengths = np.where(lengths > NO_EFFECT * lengths.max(initial=0.0), lengths, np.inf)
    triangle = np.linalg.qr(np.vstack([np.linalg.qr(j, mode="r") for j in jacobians]), mode="r")
    _, values, right = np.linalg.svd(triangle / lengths)
    padded = np.zeros(len(lengths))
    padded[: len(values)] = values
    return np.where(np.isfinite(lengths), lengths, 1.0), padded, right.T


def _seen_only(blocks: Sequence[WindowBlock], rows: Sequence[_Rows]) -> list[_Rows]:
    """The rows without what lies along combinations that are not seen, which is rounding: priors may be as weak."""
    lengths, values, vectors = decomposed(blocks, [row.jacobian for row in rows])
    hidden = vectors[:, values <= UNSEEN * values.max(initial=0.0)]
    projection = np.eye(len(lengths)) - (hidden / lengths[:, None]) @ (hidden * lengths[:, None]).T
    return [replace(row, jacobian=row.jacobian @ projection) for row in rows]


def _whitening(
    blocks: Sequence[WindowBlock], rows: Sequence[_Rows], before: WindowBlock | None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n, k) transform to k seen directions of unit curvature, and which parameters (n,) reach outside."""
    own = [] if before is None else [before]
    jacobians = [*(row.jacobian for row in rows), *(block.parameters for block in own)]
    lengths, values, vectors = decomposed([*blocks, *own], jacobians)
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
