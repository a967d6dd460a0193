"""How one controller and a plant are joined, by numbers of signals; and where the loop is opened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class Path:
    """A connection: target = factor * source.

    Attributes:
        source, target: numbers of the output and of the input that it joins.
        name: as it is written, `plant.position -> controller.position`.
    """

    name: str
    source: int
    target: int
    factor: float = 1.0


@dataclass(frozen=True)
class LoopWiring:
    """The loop.

    Attributes:
        measured: from the plant's outputs to the controller's inputs.
        commanded: from the controller's outputs to the plant's inputs.
        reference: number of the controller's input that tells where to go.
        tracked: number of the plant's output that is to follow it.
        sizes: numbers of the controller's inputs and outputs, and of the plant's inputs and outputs.
    """

    measured: tuple[Path, ...]
    commanded: tuple[Path, ...]
    reference: int
    tracked: int
    sizes: tuple[int, int, int, int]

    @cached_property
    def sensing(self) -> FloatArray:
        """(v, p) what the controller's inputs take of the plant's outputs."""
        return _matrix(self.measured, self.sizes[0], self.sizes[3])

    @cached_property
    def acting(self) -> FloatArray:
        """(m, w) what the plant's inputs take of the controller's outputs."""
        return _matrix(self.commanded, self.sizes[2], self.sizes[1])

    @property
    def paths(self) -> tuple[Path, ...]:
        """All connections."""
        return (*self.measured, *self.commanded)

    @property
    def opened(self) -> Path:
        """Where the loop is opened unless a goal names another place: at what is tracked (Eq. 4-2)."""
        return next((path for path in self.measured if path.source == self.tracked), self.commanded[0])


def _matrix(paths: tuple[Path, ...], rows: int, columns: int) -> FloatArray:
    matrix = np.zeros((rows, columns))
    for path in paths:
        matrix[path.target, path.source] += path.factor
    return matrix
