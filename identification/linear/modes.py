"""The modes of a discrete linear model: their frequencies and damping, what each gives to the response, which to keep.

A mode is a real eigenvalue or a conjugate pair. In modal coordinates modes do not see each other, so a response is the
sum of theirs, and a mode can be left out without touching the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from orchestrator.trace import ComplexArray, FloatArray

NEAR = 0.15  # relative distance within which a pair counts as a known frequency's
ReductionMethod = Literal["mrm", "msv", "mrmc"]


@dataclass(frozen=True, eq=False)
class Mode:
    """A real eigenvalue, or a conjugate pair by the one above the real axis.

    Attributes:
        eigenvalue: in the z-plane.
        step: sampling time [s].
        b, c: (m,) row of the modal input matrix and (p,) column of the modal output matrix (3-3).
    """

    eigenvalue: complex
    step: float
    b: ComplexArray
    c: ComplexArray

    @property
    def paired(self) -> bool:
        """Whether it stands for a conjugate pair, two states."""
        return self.eigenvalue.imag != 0.0

    @property
    def size(self) -> int:
        """Its number of states."""
        return 2 if self.paired else 1

    @property
    def pole(self) -> complex:
        """ln(eigenvalue) / step [rad/s], nan where there is none: an eigenvalue of 0 or on the negative real axis."""
        if self.integrating:
            return 0j
        real_and_not_positive = not self.paired and self.eigenvalue.real <= 0
        return complex(math.nan, math.nan) if real_and_not_positive else complex(np.log(self.eigenvalue)) / self.step

    @property
    def frequency(self) -> float:
        """Natural frequency [Hz] (2-28); nan for an eigenvalue that no continuous mode has."""
        return abs(self.pole) / (2 * math.pi)

    @property
    def damping(self) -> float:
        """Damping ratio (2-28): 1 for a decaying real mode, negative for an unstable one, nan without a frequency.

        An integrator has frequency 0 and, by convention, damping 1.
        """
        pole = self.pole
        return 1.0 if pole == 0 else -pole.real / abs(pole)

    @property
    def integrating(self) -> bool:
        """Whether its eigenvalue is 1 to rounding."""
        return abs(self.eigenvalue - 1) < 1e-9

    def response(self, u: FloatArray) -> FloatArray:
        """(K, p) what it gives to the response to u (K, m) from rest (3-6, 3-7)."""
        from scipy.signal import lfilter  # noqa: PLC0415 - loads slowly

        eta = lfilter([0.0, 1.0], [1.0, -self.eigenvalue], np.asarray(u, dtype=float) @ self.b)
        return np.real(np.outer(eta, self.c)) * self.size

    def mode_singular_value(self, samples: int) -> float:
        """MSV (3-4): its share in a pulse response of so many samples."""
        radius = abs(self.eigenvalue)
        powers = radius ** np.arange(samples - 1)
        return math.sqrt(float(np.linalg.norm(self.c)) * float(powers.sum()) * float(np.linalg.norm(self.b)))

    def response_magnitude(self, u: FloatArray) -> float:
        """MRM (3-8): the largest over the outputs of the mean absolute response to u (K, m).

        The outputs must be comparable: scaled alike.
        """
        return float(np.abs(self.response(u)).mean(axis=0).max())


def modes(model: LinearModel) -> tuple[Mode, ...]:
    """All modes (3-1, 3-3): pairs by falling frequency, as in the thesis' tables, then real ones by falling eigenvalue.

    Raises:
        IdentificationError: the eigenvectors do not span the space, so that there are no modal coordinates.
    """
    values, vectors = np.linalg.eig(model.a)
    if np.linalg.cond(vectors) > 1e12:
        raise IdentificationError("modes", "two eigenvalues coincide and have one eigenvector", "choose another order")
    b, c = np.linalg.solve(vectors, model.b.astype(complex)), model.c @ vectors
    found = [
        Mode(complex(value), model.step, b[i], c[:, i].astype(complex))
        for i, value in enumerate(values)
        if value.imag >= 0
    ]
    return _in_order(found)


def frequencies(eigenvalues: ComplexArray, step: float) -> tuple[Mode, ...]:
    """All modes in the order of `modes`, of which nothing but the eigenvalues are known; also where they coincide.

    Args:
        step: sampling time [s].
    """
    nothing = np.zeros(0, dtype=complex)
    return _in_order([Mode(complex(value), step, nothing, nothing) for value in eigenvalues if value.imag >= 0])


def _in_order(found: Sequence[Mode]) -> tuple[Mode, ...]:
    pairs = sorted((mode for mode in found if mode.paired), key=lambda mode: -mode.frequency)
    return (*pairs, *sorted((mode for mode in found if not mode.paired), key=lambda mode: -mode.eigenvalue.real))


def labels(found: Sequence[Mode]) -> list[str]:
    """Their numbers as in the thesis' tables: 1/2, 3/4, ..., 17, 18."""
    firsts = np.cumsum([1, *(mode.size for mode in found)])
    return [f"{first}/{first + 1}" if mode.paired else str(first) for first, mode in zip(firsts, found, strict=False)]


def from_modes(found: Sequence[Mode], like: LinearModel) -> LinearModel:
    """The real realisation of these modes: a block [[Re, Im], [-Im, Re]] for a pair, a number for a real one.

    Args:
        like: whose D, names and sampling time the model takes.

    The thesis gets real matrices by a second ORSE run on a simulated response (3-10); this needs no data and is exact.
    """
    a = np.zeros((sum(mode.size for mode in found),) * 2)
    rows, columns, at = [], [], 0
    for mode in found:
        value = mode.eigenvalue
        if mode.paired:
            a[at : at + 2, at : at + 2] = [[value.real, value.imag], [-value.imag, value.real]]
            rows += [2 * mode.b.real, -2 * mode.b.imag]
            columns += [mode.c.real, mode.c.imag]
        else:
            a[at, at] = value.real
            rows.append(mode.b.real)
            columns.append(mode.c.real)
        at += mode.size
    size = (at, len(like.inputs)), (len(like.outputs), at)
    return replace(like, a=a, b=np.reshape(rows, size[0]), c=np.reshape(columns, size[1][::-1]).T)


def ranked(values: Sequence[float]) -> list[int]:
    """The rank of each value, 1 for the largest."""
    order = sorted(range(len(values)), key=lambda i: -values[i])
    ranks = [0] * len(values)
    for rank, i in enumerate(order, start=1):
        ranks[i] = rank
    return ranks


def strongest(found: Sequence[Mode], values: Sequence[float], order: int) -> list[int]:
    """Numbers of the modes with the largest values that fit into this order, in the modes' own order."""
    kept: list[int] = []
    room = order
    for i in sorted(range(len(found)), key=lambda i: -values[i]):
        if found[i].size <= room:
            kept.append(i)
            room -= found[i].size
    return sorted(kept)


def combined(found: Sequence[Mode], values: Sequence[float], order: int, flexible: Sequence[float]) -> list[int]:
    """MRMC: of each known flexible frequency [Hz] the strongest pair within `NEAR`, the rest by strength.

    Args:
        values: MRM of each mode.

    Pairs above half the lowest known frequency that match none count as computational and are left out, so the rigid
    ones are what remains below it.
    """
    kept: list[int] = []
    for frequency in flexible:
        near = [
            i
            for i, mode in enumerate(found)
            if mode.paired and i not in kept and abs(mode.frequency - frequency) <= NEAR * frequency
        ]
        kept += sorted(near, key=lambda i: -values[i])[:1]
    limit = 0.5 * min(flexible, default=math.inf)
    rigid = [i for i, mode in enumerate(found) if not mode.paired or mode.frequency < limit]
    room = order - sum(found[i].size for i in kept)
    chosen = strongest([found[i] for i in rigid], [values[i] for i in rigid], room)
    return sorted([*kept, *(rigid[i] for i in chosen)])


def kept(
    by: ReductionMethod, found: Sequence[Mode], u: FloatArray, order: int, flexible: Sequence[float] = ()
) -> list[int]:
    """Numbers of the modes that a reduction to this order keeps.

    Args:
        u: (K, m) inputs under which the modes are weighed.
        flexible: known frequencies [Hz], for "mrmc".
    """
    if by == "msv":
        return strongest(found, [mode.mode_singular_value(len(u)) for mode in found], order)
    magnitudes = [mode.response_magnitude(u) for mode in found]
    return combined(found, magnitudes, order, flexible) if by == "mrmc" else strongest(found, magnitudes, order)


def dropping_bound(found: Sequence[Mode], kept: Sequence[int], u: FloatArray) -> float:
    """A bound on the mean absolute error of any output that dropping the other modes makes: the sum of their MRMs.

    It holds for any model with modal coordinates, stable or not, under the very input u (K, m) and from rest, because
    the error is the sum of the dropped responses (3-5) and |sum| <= sum of |.|. One dropped mode attains it. It says
    nothing about other inputs (a mode that u does not excite has MRM 0 and can be anything elsewhere), about the rms
    or the peak error, which a response that is short and high makes larger than its mean, nor about a model whose B
    or C is then updated: the update lowers the rms error, not each output's mean absolute one.
    """
    return float(sum(mode.response_magnitude(u) for i, mode in enumerate(found) if i not in set(kept)))
