"""A linear, discrete-time model: matrices with the names of what goes in and comes out.

x[k+1] = A x[k] + B u[k],    y[k] = C x[k] + D u[k]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.recursion import recursion
from orchestrator.trace import ComplexArray, FloatArray, read_only

UNIT_CIRCLE = 1 + 1e-9  # modulus up to which a pole counts as on the circle: an integrator's is 1 but for rounding


@dataclass(frozen=True, eq=False, repr=False)
class LinearModel:
    """Matrices of a linear, discrete-time model; two are equal when all of their numbers and names are.

    Attributes:
        a, b, c, d: (n, n), (n, m), (p, n), (p, m), read-only.
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
        for name, shape in {"a": (n, n), "b": (n, m), "c": (p, n), "d": (p, m)}.items():
            matrix = read_only(getattr(self, name))
            object.__setattr__(self, name, matrix)
            if matrix.shape != shape:
                place, problem = "linear model", f"{name.upper()} is {matrix.shape}, not {shape}"
                raise IdentificationError(place, problem, "fit its size")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LinearModel):
            return NotImplemented
        same = (self.step, self.inputs, self.outputs) == (other.step, other.inputs, other.outputs)
        return same and all(np.array_equal(getattr(self, name), getattr(other, name)) for name in "abcd")

    def __hash__(self) -> int:
        return hash((self.step, self.inputs, self.outputs, self.a.tobytes()))

    def __repr__(self) -> str:
        return (
            f"<LinearModel of order {self.order}, {', '.join(self.inputs)} to {', '.join(self.outputs)}, "
            f"every {self.step:g} s>"
        )

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
        return transfer(self.a, self.b, self.c, z) + self.d

    def transformed(self, basis: FloatArray) -> LinearModel:
        """The same model in states z, where x = basis z; basis is (n, n) and invertible."""
        a, b = (np.linalg.solve(basis, matrix).astype(float) for matrix in (self.a @ basis, self.b))
        return replace(self, a=a, b=b, c=self.c @ basis)

    def control(self) -> Any:
        """As python-control's state space."""
        import control  # noqa: PLC0415 - slow to import, and few need it

        return control.ss(self.a, self.b, self.c, self.d, self.step)


def transfer(a: FloatArray, b: FloatArray, c: FloatArray, z: ComplexArray) -> ComplexArray:
    """C (z I - A)^-1 B, over the leading axes of the matrices and of z."""
    inner = np.linalg.solve(z[..., None, None] * np.eye(a.shape[-1]) - a, b.astype(complex))
    return np.asarray(c @ inner)
