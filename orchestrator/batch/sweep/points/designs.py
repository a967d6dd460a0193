"""How the points of a sweep are chosen: any stretch of them is known without the others, and they do not depend on how
many there are, so that a study can be extended and resumed.

Random numbers come from `numpy.random.SeedSequence(seed, spawn_key=(block,))`, a block of points each.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.stats import qmc

from orchestrator.batch.sweep.points.factors import Space
from orchestrator.trace import FloatArray

BLOCK = 1024  # points that are drawn together; a power of two


class PointDesign(Protocol):
    """Points in a space."""

    @property
    def count(self) -> int:
        """How many there are."""

    def points(self, first: int, stop: int) -> FloatArray:
        """(stop - first, d) those from one number to another."""


@dataclass(frozen=True)
class Grid:
    """All combinations of levels; the last factor changes fastest."""

    space: Space

    @property
    def count(self) -> int:
        return math.prod(len(factor.law.levels) for factor in self.space.factors)

    def points(self, first: int, stop: int) -> FloatArray:
        left, columns = np.arange(first, stop), []
        for factor in reversed(self.space.factors):
            levels = factor.law.levels
            columns.append(levels[left % len(levels)])
            left = left // len(levels)
        return np.stack(columns[::-1], axis=1) if columns else np.zeros((stop - first, 0))


@dataclass(frozen=True, eq=False)
class Listed:
    """Points (N, d) that are written out."""

    table: FloatArray

    @property
    def count(self) -> int:
        return len(self.table)

    def points(self, first: int, stop: int) -> FloatArray:
        return self.table[first:stop]


@dataclass(frozen=True, kw_only=True)
class Drawn(ABC):
    """Points that come in blocks of shares.

    Attributes:
        size: points of a block.
    """

    space: Space
    count: int
    seed: int
    size: int = BLOCK

    def points(self, first: int, stop: int) -> FloatArray:
        pieces = []
        for block in range(first // self.size, -(-stop // self.size)):
            begin = block * self.size
            shares = _block(self, block)[max(first - begin, 0) : stop - begin]
            pieces.append(self.space.at(shares))
        return np.concatenate(pieces) if pieces else np.zeros((0, len(self.space)))

    @abstractmethod
    def shares(self, block: int) -> FloatArray:
        """(size, d) of a block."""


@dataclass(frozen=True, kw_only=True)
class MonteCarlo(Drawn):
    """Independent points."""

    def shares(self, block: int) -> FloatArray:
        return generator(self.seed, block).random((self.size, len(self.space)))


@dataclass(frozen=True, kw_only=True)
class SobolSequence(Drawn):
    """A scrambled Sobol' sequence (Owen 1998)."""

    def shares(self, block: int) -> FloatArray:
        return _sobol(len(self.space), self.seed, block)


@dataclass(frozen=True, kw_only=True)
class Hypercubes(Drawn):
    """Latin hypercubes of `size` points (McKay, Beckman, Conover 1979), one after the other."""

    def shares(self, block: int) -> FloatArray:
        cube: FloatArray = qmc.LatinHypercube(len(self.space), rng=generator(self.seed, block)).random(self.size)
        return cube


@dataclass(frozen=True, kw_only=True)
class SobolIndices(Drawn):
    """Saltelli's points (Computer Physics Communications 181, 2010): of each base sample A, then A with one column each
    from B, with `second_order` B with one column each from A, then B. The order is SALib's.

    Attributes:
        size: points of a base sample.
    """

    second_order: bool = False
    size: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", group_size(len(self.space), self.second_order))

    def shares(self, block: int) -> FloatArray:
        d = len(self.space)
        both = _sobol(2 * d, self.seed, block // BLOCK)[block % BLOCK]
        a, b = both[:d], both[d:]
        own = np.eye(d, dtype=bool)
        crossed = [np.where(own, b, a)] + ([np.where(own, a, b)] if self.second_order else [])
        return np.concatenate([a[None], *crossed, b[None]])


def group_size(factors: int, second_order: bool) -> int:
    """Points of a base sample for Sobol' indices."""
    return 2 * factors + 2 if second_order else factors + 2


@dataclass(frozen=True, kw_only=True)
class Morris(Drawn):
    """Trajectories on a grid of `levels`, in which one factor after the other moves by `levels` / (2 (`levels` - 1))
    (Morris, Technometrics 33, 1991).

    Attributes:
        size: points of a trajectory.
    """

    levels: int = 4
    size: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", len(self.space) + 1)

    def shares(self, block: int) -> FloatArray:
        d, rng = len(self.space), generator(self.seed, block)
        move = self.levels / (2 * (self.levels - 1))
        lower = rng.integers(self.levels // 2, size=d) / (self.levels - 1)
        upwards, order = rng.random(d) < 0.5, rng.permutation(d)
        begin = np.where(upwards, lower, lower + move)
        moved = np.tri(d + 1, d, -1, dtype=bool)[:, np.argsort(order)]  # those that have moved at each point
        return np.where(moved, np.where(upwards, lower + move, lower), begin)


def generator(seed: int, *key: int) -> np.random.Generator:
    """Random numbers that belong to a part of a study."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def seed_of(seed: int, point: int, component: int) -> int:
    """The seed of a component's noise at a point, from 0 to 2^31 - 1: the seed contract of a study.

    Args:
        component: its number among those with noise.
    """
    words = np.random.SeedSequence(seed, spawn_key=(1, component, point)).generate_state(1)
    return int(words[0]) & 0x7FFFFFFF


@lru_cache(maxsize=4)
def _block(design: Drawn, block: int) -> FloatArray:
    """The block that was asked for before is asked for again: runs come in smaller pieces."""
    return design.shares(block)


@lru_cache(maxsize=4)
def _sobol(dimensions: int, seed: int, block: int) -> FloatArray:
    engine = qmc.Sobol(dimensions, rng=generator(seed))
    if block:
        engine.fast_forward(block * BLOCK)
    found: FloatArray = engine.random(BLOCK)
    return found
