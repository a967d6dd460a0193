"""The rows of a sweep as arrays, of no more runs than a page shows; and which factors go with what came out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from orchestrator.batch.sweep.points.factors import Factor
from orchestrator.batch.sweep.runs.preparation import PreparedSweep
from orchestrator.batch.sweep.runs.rows import FAILED, HELD
from orchestrator.batch.sweep.told.result import SweepResult
from orchestrator.batch.sweep.told.sensitivity import rank_correlations
from orchestrator.display.titles import with_unit
from orchestrator.trace import FloatArray

SHOWN = 2000  # runs


@dataclass(frozen=True, eq=False)
class SweepNumbers:
    """Of n runs, spread evenly over all, what varied and what came out.

    Attributes:
        values: (n, d) of the factors; of words their numbers.
        figures, held: (n, m) figures, and 1 where what was asked held, 0 where not, NaN where it was not judged.
        passed: (n,) 1 where a run passed; failed: (n,) whether it failed.
        correlations: (d, m) Spearman's, of factors and figures.
        told: of how many runs it is, where these are not all.
    """

    names: list[str]
    titles: list[str]
    values: FloatArray
    figures: FloatArray
    held: FloatArray
    passed: FloatArray
    failed: NDArray[np.bool_]
    correlations: FloatArray
    told: str

    @property
    def varied(self) -> bool:
        """Whether anything varies."""
        return bool(self.names)

    def leading(self, place: int) -> list[int]:
        """The factors, those first that go best with a figure."""
        return _largest_first(self.correlations[:, place])

    @property
    def decisive(self) -> list[int]:
        """The factors, those first that go best with whether runs pass; where all do, or none, with the figures."""
        with_passing = rank_correlations(self.values, self.passed)
        if not np.isfinite(with_passing).any() and self.correlations.size:
            with_passing = np.max(np.abs(np.nan_to_num(self.correlations)), axis=1)
        return _largest_first(with_passing)


def numbers_of(study: PreparedSweep, result: SweepResult) -> SweepNumbers:
    """The arrays of a sweep."""
    factors, asked = study.setup.space.factors, [one.name for one in study.setup.asked]
    names = [factor.name for factor in factors]
    held = [name + HELD for name in asked]
    rows = result.sampled([*names, "state", "passed", *asked, *held], SHOWN)
    values = np.stack([_column(rows, one) for one in factors], axis=1) if factors else np.zeros((len(rows), 0))
    figures = _matrix(rows, asked)
    correlations = np.stack([rank_correlations(values, column) for column in figures.T], axis=1) if asked else None
    return SweepNumbers(
        names,
        [with_unit(factor.name, factor.unit) for factor in factors],
        values,
        figures,
        _matrix(rows, held),
        _numbers(rows["passed"]),
        rows["state"].to_numpy(zero_copy_only=False) == FAILED,
        np.zeros((len(names), 0)) if correlations is None else correlations,
        "" if len(rows) == result.document["runs"] else f", of {len(rows):,} runs, spread evenly",
    )


def _largest_first(found: FloatArray) -> list[int]:
    return [int(place) for place in np.argsort(-np.abs(np.nan_to_num(found)), kind="stable")]


def _column(rows: pa.Table, factor: Factor) -> FloatArray:
    if not factor.words:
        return _numbers(rows[factor.name])
    return np.array([float(factor.words.index(word)) for word in rows[factor.name].to_pylist()])


def _matrix(rows: pa.Table, names: list[str]) -> FloatArray:
    return np.stack([_numbers(rows[name]) for name in names], axis=1) if names else np.zeros((len(rows), 0))


def _numbers(column: pa.ChunkedArray) -> FloatArray:
    return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
