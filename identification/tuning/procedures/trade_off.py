"""The trade-off between goals: what the objective comes to where one that binds asks for more, or for less."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from identification.tuning.goals.goal import Goal
from identification.tuning.procedures.descent import Seen, program, rank
from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from identification.tuning.procedures.procedure import NEAR, Trade
from identification.tuning.procedures.unknowns import Span, parts
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

SHIFTS = (0.15, 0.3)  # by which a bound is moved either way, of its size
MOST = 3  # goals of which the trade-off is told


def trades(
    problem: TuningProblem, spans: Sequence[Span], best: CandidateJudgement, progress: Progress
) -> tuple[Trade, ...]:
    """Optima under other bounds of the goals that bind most; each goes on from its neighbour.

    Args:
        best: the optimum, or where no point holds all hard goals the one that misses least.
    """
    found = []
    binding = _binding(best)
    for place, number in enumerate(binding):
        progress(place / len(binding), f"trade-off of goal {place + 1} of {len(binding)}")
        goal = best.goals[number]
        sides = [list(_followed(problem, spans, best, number, sign)) for sign in (-1, 1)]
        ends = [*reversed(sides[0]), (goal, best), *sides[1]]
        found.append(Trade(number, np.array([_bound(moved) for moved, _ in ends]), tuple(end for _, end in ends)))
    return tuple(found)


def _binding(best: CandidateJudgement) -> list[int]:
    """Hard goals with one bound that are at it, those that are missed most first."""
    if not best.stable:
        return []
    worst = {number: float(best.missed[number].max()) for number in best.hard}
    one_sided = [n for n in worst if (best.goals[n].lower is None) != (best.goals[n].upper is None)]
    near = [number for number in one_sided if worst[number] >= max(best.most_missed, 0.0) - NEAR]
    return sorted(near, key=lambda number: -worst[number])[:MOST]


def _followed(
    problem: TuningProblem, spans: Sequence[Span], best: CandidateJudgement, number: int, sign: int
) -> Iterator[tuple[Goal, CandidateJudgement]]:
    """The goal with its bound moved to one side, step by step, and the optimum there."""
    point: FloatArray = parts(spans, best.values)
    for shift in SHIFTS:
        moved = _moved(best.goals[number], sign * shift)
        goals = tuple(moved if i == number else goal for i, goal in enumerate(problem.goals))
        seen = Seen(replace(problem, goals=goals), spans)
        point = min([point, program(seen, point)], key=lambda candidate: rank(seen(candidate)))
        yield moved, seen(point)


def _moved(goal: Goal, part: float) -> Goal:
    shift = part * goal.size
    if goal.lower is not None:
        return replace(goal, lower=goal.lower + shift)
    assert goal.upper is not None
    return replace(goal, upper=goal.upper + shift)


def _bound(goal: Goal) -> float:
    return float(goal.upper if goal.lower is None else goal.lower)  # type: ignore[arg-type]
