"""Exact Jacobians of free runs: where its FMUs carry tangents, one run a window gives its outputs and derivatives.

A delay acts outside the FMUs, so that differences stay for it. So they do for all where they show another slope: what
acts in steps (quantisation, a sign) has derivatives that say nothing of its next step.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import FmuError, TangentsMissing
from identification.estimation.arrow_least_squares import Point
from identification.estimation.workers import Pool, SimulationTask
from identification.output_error.search.problem import Problem
from orchestrator.trace import FloatArray

LOG = logging.getLogger("servotwin.estimation")
WITNESSES = 2  # windows in which exact derivatives are compared with differences
_APART = 0.1  # of a column: how far the two may lie apart

Columns = Mapping[int, list[FloatArray]]
"""Column of the Jacobian -> (N,) of each window."""


@dataclass(frozen=True)
class ValueSlopes:
    """How the values that FMUs are given move with the entries of a window's free vector.

    Attributes:
        names: component.variable of the values that move.
        slopes: (d, n + s) derivative of each by each entry; 0 for the columns that differences are left for.
        columns: those that tangents give.
    """

    names: tuple[str, ...]
    slopes: FloatArray
    columns: tuple[int, ...]


def chain(problem: Problem, point: Point, window: int) -> ValueSlopes:
    """The derivatives of all values of a window at a point."""
    moved = [*problem.slopes(window, point), *({state.name: state.size} for state in problem.estimated)]
    columns = [c for c, values in enumerate(moved) if all("." in name for name in values)]
    names = tuple(dict.fromkeys(name for c in columns for name in moved[c]))
    slopes = np.zeros((len(names), len(moved)))
    for c in columns:
        for name, slope in moved[c].items():
            slopes[names.index(name), c] = slope
    return ValueSlopes(names, slopes, tuple(columns))


def exact_columns(problem: Problem, pool: Pool, windows: Sequence[int], point: Point) -> Columns:
    """The columns of the Jacobian that tangents give, for row w of the point's states in windows[w].

    Raises:
        TangentsMissing: an FMU carries none.
        FmuError: a run failed, or a derivative is not finite.
    """
    rules = [chain(problem, point, window) for window in windows]
    if not any(rule.names for rule in rules):
        return {}
    given = {c for c in rules[0].columns if all(c in rule.columns for rule in rules)}
    asked = [row for row, rule in enumerate(rules) if rule.names]
    tasks = [
        SimulationTask(windows[row], problem.values(windows[row], point, row), 0, rules[row].names) for row in asked
    ]
    columns = {c: [np.zeros(problem.windows[w].measured.size) for w in windows] for c in sorted(given)}
    for row, outcome in zip(asked, pool.run(tasks), strict=True):
        window = problem.windows[windows[row]]
        if isinstance(outcome, FmuError):
            raise outcome
        assert outcome is not None
        weighted = window.weight[:, None] * (outcome[:, :, 1:] @ rules[row].slopes)
        if not np.all(np.isfinite(weighted)):
            raise FmuError(window.name, "a derivative is not finite")
        for c, column in columns.items():
            column[row] = weighted[:, :, c].ravel()
    return columns


def require_agreement(problem: Problem, exact: Columns, differences: Mapping[int, Sequence[FloatArray | None]]) -> None:
    """See that differences show the slopes that tangents have; those of runs that failed (None) say nothing.

    Raises:
        TangentsMissing: they do not; the message names the first such entry.
    """
    free = [parameter.name for parameter in problem.parameters.free]
    names = [*free, *(state.name for state in problem.estimated)]
    for c, found in differences.items():
        pairs = [(a, b) for a, b in zip(exact[c], found, strict=False) if b is not None]
        if not pairs:
            continue
        one, other = (np.concatenate(of) for of in zip(*pairs, strict=True))
        if np.linalg.norm(one - other) > _APART * max(np.linalg.norm(one), np.linalg.norm(other)):
            raise TangentsMissing(names[c], "acts in steps: differences show another slope than its exact derivative")


def say(reason: TangentsMissing) -> None:
    """Tell why differences are taken."""
    LOG.info("the Jacobian is taken by differences: %s", reason)
