"""Linear plants side by side, as arrays over plants; and the computing delay before their inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import expm, logm

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel, transfer
from orchestrator.trace import ComplexArray, FloatArray

DECADES = ((1e-6, 1e-3, 20), (1e-3, 1.0, 120))  # from and to, of half the sampling frequency: frequencies a decade
AROUND = (0.25, 0.6, 1.0, 1.7, 3.0, 6.0)  # of a mode's half width, where it is looked at on either side
NARROWEST = 1e-4  # half width of a mode, of its frequency
SAME = 1e-9  # share of a frequency by which another one is no other
CHUNK = 20_000  # linear systems that are solved at once


@dataclass(frozen=True, eq=False)
class PlantSet:
    """N linear, sampled plants with the same inputs and outputs; the smaller ones have states that nothing moves.

    Attributes:
        names: of the N plants.
        a, b, c: (N, n, n), (N, n, m), (N, p, n).
        step: sampling time [s].
        inputs, outputs: names of the m inputs and p outputs.
    """

    names: tuple[str, ...]
    a: FloatArray
    b: FloatArray
    c: FloatArray
    step: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @classmethod
    def of(cls, models: Mapping[str, LinearModel]) -> PlantSet:
        """These models, which have the first one's sampling time, inputs and outputs, in any order, and maybe more.

        Raises:
            IdentificationError: one lacks an input or output, is sampled otherwise, or reacts at once to an input.
        """
        taken = alike(models)
        first = next(iter(taken.values()))
        most = max(model.order for model in taken.values())
        a, b, c = (np.stack([padded(getattr(model, m), m, most) for model in taken.values()]) for m in "abc")
        return cls(tuple(taken), a, b, c, first.step, first.inputs, first.outputs)

    def __len__(self) -> int:
        return len(self.names)

    def only(self, numbers: Sequence[int]) -> PlantSet:
        """Some of them."""
        chosen = list(numbers)
        names = tuple(self.names[i] for i in chosen)
        return replace(self, names=names, a=self.a[chosen], b=self.b[chosen], c=self.c[chosen])

    def joined(self, others: PlantSet) -> PlantSet:
        """These and others of the same size."""
        a, b, c = (np.concatenate([getattr(self, name), getattr(others, name)]) for name in "abc")
        return replace(self, names=(*self.names, *others.names), a=a, b=b, c=c)

    def parted(self, first: int) -> tuple[PlantSet, PlantSet]:
        """So many of them from the beginning, at most all, and the others."""
        first = min(first, len(self))
        return self.only(range(first)), self.only(range(first, len(self)))

    @cached_property
    def frequencies(self) -> FloatArray:
        """(N, F) rising angular frequencies of each plant, up to half the sampling frequency, denser at its modes."""
        end = np.pi / self.step
        parts = [np.geomspace(low, high, round(np.log10(high / low) * many) + 1) for low, high, many in DECADES]
        base = end * np.unique(np.concatenate(parts))
        poles = np.linalg.eigvals(self.a)
        rates = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12).astype(complex)) / self.step
        omega = np.abs(rates.imag)
        width = np.maximum(np.abs(rates.real), NARROWEST * omega)
        around = np.concatenate([omega + sign * part * width for part in AROUND for sign in (-1, 1)], axis=1)
        inside = np.clip(around, base[0], base[-1])
        return _distinct(
            np.sort(np.concatenate([np.broadcast_to(base, (len(self), len(base))), inside], axis=1), axis=1)
        )

    @cached_property
    def responses(self) -> ComplexArray:
        """(N, F, p, m) at `frequencies`."""
        number = np.repeat(np.arange(len(self)), self.frequencies.shape[1])
        found = self.response(number, self.frequencies.ravel())
        return found.reshape(*self.frequencies.shape, len(self.outputs), len(self.inputs))

    def response(self, number: np.ndarray, omega: FloatArray) -> ComplexArray:
        """(Q, p, m) of the plants of these numbers (Q,), each at one angular frequency (Q,)."""
        parts = [
            transfer(self.a[n], self.b[n], self.c[n], np.exp(1j * w * self.step)) for n, w in _chunks(number, omega)
        ]
        return np.concatenate(parts)


def _chunks(number: np.ndarray, omega: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
    starts = range(0, max(len(number), 1), CHUNK)
    return [(number[i : i + CHUNK], omega[i : i + CHUNK]) for i in starts]


def alike(models: Mapping[str, LinearModel]) -> dict[str, LinearModel]:
    """The models with the first one's inputs and outputs alone, in their order.

    Raises:
        IdentificationError: as `PlantSet.of`.
    """
    first = next(iter(models.values()))
    return {name: _like(f"plants.{name}", model, first) for name, model in models.items()}


def _like(place: str, model: LinearModel, first: LinearModel) -> LinearModel:
    """The model with the first one's inputs and outputs alone, in their order."""
    if not np.isclose(model.step, first.step, rtol=1e-9, atol=0):
        problem = f"is sampled every {model.step:g} s, and others every {first.step:g} s"
        raise IdentificationError(place, problem, "identify all plants at one sampling time")
    for kind, names, wanted in (
        ("input", model.inputs, first.inputs),
        ("output", model.outputs, first.outputs),
    ):
        missing = [name for name in wanted if name not in names]
        if missing:
            there = f"there are {', '.join(names)}"
            raise IdentificationError(place, f"has no {kind} '{missing[0]}', which others have", there)
    rows = [model.outputs.index(name) for name in first.outputs]
    columns = [model.inputs.index(name) for name in first.inputs]
    if np.any(model.d[np.ix_(rows, columns)]):
        raise IdentificationError(
            place, "reacts at once to its input (D is not zero)", "give the loop a `delay`, or identify with D = 0"
        )
    b, c, d = model.b[:, columns], model.c[rows], np.zeros((len(rows), len(columns)))
    return LinearModel(model.a, b, c, d, model.step, first.inputs, first.outputs)


def padded(matrix: FloatArray, name: str, order: int) -> FloatArray:
    """A, B or C of a model, as `name` says, with so many states; nothing moves those that are added."""
    rows, columns = matrix.shape
    target = {"a": (order, order), "b": (order, columns), "c": (rows, order)}[name]
    full = np.zeros(target)
    full[:rows, :columns] = matrix
    return full


def delayed(place: str, model: LinearModel, delay: float, inputs: Sequence[str]) -> LinearModel:
    """The model whose `inputs` act a time [s] after they are sampled; exact between samples, too.

    Args:
        inputs: names of those that are delayed; others than the model's mean nothing.

    Raises:
        IdentificationError: the delay is no whole number of samples, and the model has no counterpart in continuous
            time to look in between.
    """
    whole = int(np.ceil(delay / model.step - 1e-9))
    if whole <= 0:
        return model
    late = whole - delay / model.step  # part of a sample in which the newest of the held values acts already
    columns = [model.inputs.index(name) for name in inputs if name in model.inputs]
    new = np.zeros_like(model.b)
    if late > 1e-9:
        new[:, columns] = _begun(place, model, late)[:, columns]
    old = model.b.copy()
    old[:, columns] -= new[:, columns]
    return _held(model, whole, columns, new, old)


def _begun(place: str, model: LinearModel, part: float) -> FloatArray:
    """(n, m) what an input gives that acts over the last `part` of a sampling period alone."""
    n, m = model.b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:], block[n:, n:] = model.a, model.b, np.eye(m)
    rate = None if np.any(np.abs(np.linalg.eigvals(model.a)) < 1e-9) else logm(block)
    if rate is None or np.abs(rate.imag).max() > 1e-6 or np.abs(expm(rate.real) - block).max() > 1e-7:
        raise IdentificationError(
            place, "has no counterpart in continuous time, to delay it by a part of a sample", "delay by whole samples"
        )
    return np.asarray(expm(rate.real * part)[:n, n:])


def _held(model: LinearModel, whole: int, columns: Sequence[int], new: FloatArray, old: FloatArray) -> LinearModel:
    """The model behind a line of `whole` samples, whose last acts by `old` and the one after by `new`.

    x[k+1] = A x + new u[k - whole + 1] + old u[k - whole]; columns that are not delayed act by `old` at once.
    """
    n, m, held = model.order, len(model.inputs), len(columns)
    size = n + whole * held
    a, b = np.zeros((size, size)), np.zeros((size, m))
    c = np.zeros((len(model.outputs), size))
    a[:n, :n], c[:, :n] = model.a, model.c
    undelayed = [i for i in range(m) if i not in columns]
    b[:n, undelayed] = old[:, undelayed]
    first = [n + i for i in range(held)]  # u[k-1]
    last = [size - held + i for i in range(held)]  # u[k - whole]
    a[np.ix_(range(n), last)] += old[:, columns]
    if whole > 1:
        a[np.ix_(range(n), [i - held for i in last])] += new[:, columns]
    else:
        b[:n, columns] += new[:, columns]
    b[first, columns] = 1.0
    for i in range(n + held, size):
        a[i, i - held] = 1.0
    d = model.d.copy()
    c[:, last] += d[:, columns]  # what is seen is what acted until now
    d[:, columns] = 0.0
    return LinearModel(a, b, c, d, model.step, model.inputs, model.outputs)


def _distinct(rising: FloatArray) -> FloatArray:
    """Rows (N, F) in which nothing stands twice, as modes that are a pair do: the widest gaps are halved instead.

    What is sought between neighbours, a minimum or a crossing, would not be found between two that are the same.
    """
    rows = []
    for row in rising:
        kept = row[np.append(True, np.diff(row) > SAME * row[1:])]
        kept[-1] = row[-1]
        wide = np.argsort(np.diff(np.log(kept)))[2 * len(kept) - 1 - len(row) :]
        rows.append(np.sort(np.append(kept, np.sqrt(kept[wide] * kept[wide + 1]))))
    return np.array(rows)
