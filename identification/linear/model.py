"""A linear, discrete-time model: matrices with the names of what goes in and comes out.

x[k+1] = A x[k] + B u[k],    y[k] = C x[k] + D u[k]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.recursion import recursion
from orchestrator.trace import ComplexArray, FloatArray

UNIT_CIRCLE = 1 + 1e-9  # modulus up to which a pole counts as on the circle: an integrator's is 1 but for rounding


@dataclass(frozen=True)
class LinearModel:
    """Matrices of a linear, discrete-time model.

    Attributes:
        a, b, c, d: (n, n), (n, m), (p, n), (p, m).
        step: sampling time [s].
        inputs, outputs: names of the m inputs and p outputs.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    step: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        n, m, p = self.order, len(self.inputs), len(self.outputs)
        for name, matrix, shape in (
            ("A", self.a, (n, n)),
            ("B", self.b, (n, m)),
            ("C", self.c, (p, n)),
            ("D", self.d, (p, m)),
        ):
            if matrix.shape != shape:
                raise IdentificationError("linear model", f"{name} is {matrix.shape}, not {shape}", "fit its size")

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.a.shape[0])

    @property
    def eigenvalues(self) -> ComplexArray:
        """(n,) poles in the z-plane."""
        return np.linalg.eigvals(self.a).astype(complex)

    @property
    def stable(self) -> bool:
        """Whether no pole is outside the unit circle, to rounding; an integrator is stable in this sense."""
        return bool(np.abs(self.eigenvalues).max(initial=0.0) <= UNIT_CIRCLE)

    def states(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """(K, n) states under inputs u (K, m) from a state `start` (n,), the origin by default.

        Those of an unstable model that overflow are inf or nan.
        """
        force = np.asarray(u, dtype=float) @ self.b.T
        first = np.zeros(self.order) if start is None else np.asarray(start, dtype=float)
        return recursion(self.a, force[:, None], first[None])[0][:, 0]

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """(K, p) outputs under inputs u (K, m) from a state `start` (n,), the origin by default."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.states(u, start) @ self.c.T + np.asarray(u, dtype=float) @ self.d.T

    def frequency_response(self, omega: FloatArray) -> ComplexArray:
        """(F, p, m) response at angular frequencies [rad/s]."""
        z = np.exp(1j * np.asarray(omega) * self.step)
        inner = np.linalg.solve(z[:, None, None] * np.eye(self.order) - self.a, self.b.astype(complex)[None])
        return np.asarray(self.c @ inner + self.d)

    def transformed(self, basis: FloatArray) -> LinearModel:
        """The same model in states z, where x = basis z; basis is (n, n) and invertible."""
        a, b = np.asarray(np.linalg.solve(basis, self.a @ basis)), np.asarray(np.linalg.solve(basis, self.b))
        return replace(self, a=a.astype(float), b=b.astype(float), c=self.c @ basis)

    def control(self) -> Any:
        """As python-control's state space."""
        import control  # noqa: PLC0415 - slow to import, and few need it

        return control.ss(self.a, self.b, self.c, self.d, self.step)
