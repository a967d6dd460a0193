"""Directions in which a linear model can change, less those that only change its state's basis.

A model of n states, m inputs and p outputs has n (m + p) degrees of freedom besides D, fewer than its matrices have
elements. The directions orthogonal to all changes of basis are found anew at every point: no canonical form is needed,
and none can be badly conditioned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from identification.linear.model import LinearModel
from identification.linear.recursion import recursion
from orchestrator.trace import BoolArray, FloatArray

_NEGLIGIBLE = 1e-10
_HORIZON = 200  # samples over which outputs are looked at


@dataclass(frozen=True, eq=False)
class Directions:
    """t orthonormal directions: what each adds to A (t, n, n), B (t, n, m), C (t, p, n) and D (t, p, m)."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray

    def __len__(self) -> int:
        return len(self.a)

    def moved(self, model: LinearModel, step: FloatArray) -> LinearModel:
        """The model after a step (t,) along the directions."""
        a, b, c, d = (np.tensordot(step, part, axes=1) for part in (self.a, self.b, self.c, self.d))
        return replace(model, a=model.a + a, b=model.b + b, c=model.c + c, d=model.d + d)


def local_directions(model: LinearModel, feedthrough: BoolArray, held: Sequence[FloatArray] = ()) -> Directions:
    """An orthonormal basis of the changes that matter.

    Args:
        feedthrough: (p, m), where D is free.
        held: gradients (n n + n m + p n + d,) of what must not change to first order, in the order of `flattened`.

    Source: McKelvey, Helmersson and Ribarits 2004 (data-driven local coordinates).
    """
    n, m, p, free = model.order, len(model.inputs), len(model.outputs), int(feedthrough.sum())
    generators = np.eye(n * n).reshape(n * n, n, n)
    same = [flattened(model.a @ t - t @ model.a, -t @ model.b, model.c @ t, np.zeros(free)) for t in generators]
    basis = qr(np.array(same + list(held)).T)[0][:, n * n + len(held) :].T
    a, b, c, d = np.split(basis, np.cumsum([n * n, n * m, p * n]), axis=1)
    direct = np.zeros((len(basis), p, m))
    direct[:, feedthrough] = d
    return Directions(a.reshape(-1, n, n), b.reshape(-1, n, m), c.reshape(-1, p, n), direct)


def flattened(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """All elements in one vector; `d` are D's free ones."""
    return np.concatenate([a.ravel(), b.ravel(), c.ravel(), d.ravel()])


def balanced_basis(model: LinearModel, inputs: Sequence[FloatArray]) -> FloatArray:
    """(n, n) basis in which the states under these inputs are as large as what they do to the outputs.

    The observability Gramian is over a finite horizon, so that integrating and unstable models have one.
    States that overflow are left as they are.

    Args:
        inputs: a record (K, m).
    """
    states = np.vstack([model.states(u) for u in inputs])
    with np.errstate(over="ignore", invalid="ignore"):
        reach = states.T @ states / len(states)
    if not np.isfinite(reach).all():
        return np.eye(model.order)
    reach += _NEGLIGIBLE * max(float(np.trace(reach)), 1e-300) * np.eye(model.order)
    seen = recursion(model.a.T, np.zeros((_HORIZON, *model.c.shape)), model.c)[0].reshape(-1, model.order)
    root = np.linalg.cholesky(reach)
    _, sizes, right = np.linalg.svd(seen @ root, full_matrices=False)
    sizes = np.maximum(sizes, _NEGLIGIBLE * sizes[0])
    return np.asarray(root @ right.T / np.sqrt(sizes))
