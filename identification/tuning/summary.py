"""A tuning as `summary.json` holds it, and what of it is written: the controller with its values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict

from identification.method import Calibrated
from identification.results import ParameterSummary, Summary, VerdictSummary, finite
from identification.tuning.goals.goal import Goal
from identification.tuning.goals.table import MEASURES
from identification.tuning.outcome import TuningOutcome
from identification.tuning.procedures.problem import CandidateJudgement
from identification.tuning.procedures.procedure import HELD, Descent, held_share
from identification.tuning.rig import cases, not_held
from identification.tuning.study import CONTROLLER
from identification.tuning.tuning import Tuning
from orchestrator.measures import share_interval
from orchestrator.results import CaseDocument, versions
from orchestrator.trace import BoolArray

PERCENTILES = (0, 1, 50, 99, 100)


class GoalSummary(TypedDict):
    """A goal and its figures: plant -> value in `unit`, null where there is none.

    Attributes:
        kind: "hard", "soft" or "minimised".
        held: whether all plants hold its bounds; null for what is minimised.
        binding: plants at its bound, or that miss it most.
    """

    goal: str
    measure: str
    unit: str
    kind: str
    at_least: float | None
    at_most: float | None
    weight: float
    figures: dict[str, float | None]
    held: bool | None
    binding: list[str]


class LoopSummary(TypedDict):
    """A plant's closed loop: the largest modulus of its poles, and all of them [re, im]."""

    stable: bool
    radius: float
    poles: list[list[float]]


@dataclass(frozen=True)
class DescentSummary:
    """Where a start of the search led."""

    start: Mapping[str, float]
    values: Mapping[str, float]
    objective: float
    feasible: bool
    evaluations: int


class ShareSummary(TypedDict):
    """A share of draws, and where that of all draws lies, 95 % sure."""

    share: float
    ci95: list[float]


class DrawnGoalSummary(TypedDict):
    """A goal over draws.

    Attributes:
        held: by which share; null for what is minimised.
        percentiles: the least, 1st, 50th and 99th percentile and largest figure of stable loops; none without any.
    """

    goal: str
    held: ShareSummary | None
    percentiles: list[float | None]


class UnseenSummary(TypedDict):
    """What draws do that the values were not fitted to; `held` is the share that holds all hard goals."""

    stable: ShareSummary
    held: ShareSummary
    goals: list[DrawnGoalSummary]


class DrawsSummary(TypedDict):
    """What draws of the plants do.

    Attributes:
        count: of those that the values had to hold for, and of those unseen.
        asked: the share that has to hold all hard goals; `held`: that does.
    """

    count: int
    asked: float
    held: float
    unseen: UnseenSummary


class RigSummary(TypedDict):
    """How the design did in the cases of a scenario on the nonlinear rig."""

    scenario: str
    held: bool
    cases: list[CaseDocument]


class TuningSummary(Summary):
    """The summary of a tuning.

    Attributes:
        objective: at the values; null where a loop is unstable.
        starts: of the search, and how many of them `agree` on the values.
        design: what the procedure has found out beside the values, in words -> a figure.
    """

    feasible: bool
    objective: float | None
    goals: list[GoalSummary]
    loops: dict[str, LoopSummary]
    starts: list[DescentSummary]
    agree: int
    design: NotRequired[dict[str, float]]
    draws: NotRequired[DrawsSummary]
    rigs: NotRequired[list[RigSummary]]


def summary(result: Tuning) -> TuningSummary:
    """The tuning as `summary.json` holds it."""
    found, document = result.found, basic_summary(result, "tune")
    document["loops"] = _loops(result)
    if found.drawn is not None and result.unseen is not None:
        document["draws"] = {
            "count": len(found.drawn.radius),
            "asked": found.share,
            "held": held_share(found.drawn),
            "unseen": _unseen(result.unseen),
        }
    return document


def basic_summary(result: TuningOutcome, method: str) -> TuningSummary:
    """What all tunings tell, without loops and draws."""
    found = result.found
    document: TuningSummary = {
        "title": result.study.title,
        "method": method,
        "parameters": _parameters(result),
        "feasible": found.feasible,
        "objective": finite(found.best.objective),
        "goals": goal_summaries(result),
        "loops": {},
        "starts": [_descent(descent) for descent in found.descents],
        "agree": found.agreeing,
        "fit": {},
        "data": [],
        "versions": versions(),
        "warnings": result.remarks,
        "verdict": verdict(result),
    }
    if result.rigs:
        document["rigs"] = [
            {"scenario": rig.scenario.path.name, "held": rig.passed, "cases": cases(rig)} for rig in result.rigs
        ]
    if found.figures:
        document["design"] = dict(found.figures)
    return document


def _unseen(drawn: CandidateJudgement) -> UnseenSummary:
    stable = drawn.radius < 1.0
    goals: list[DrawnGoalSummary] = []
    for goal, figures, missed in zip(drawn.goals, drawn.figures[:, stable], drawn.missed, strict=True):
        found = np.percentile(figures, PERCENTILES, method="inverted_cdf").tolist() if figures.size else []
        held = None if goal.minimised else _share(stable & (missed <= HELD))
        goals.append({"goal": words(goal), "held": held, "percentiles": [finite(value) for value in found]})
    return {"stable": _share(stable), "held": _share(drawn.misses <= HELD), "goals": goals}


def _share(held: BoolArray) -> ShareSummary:
    return {"share": float(held.mean()), "ci95": list(share_interval(int(held.sum()), len(held)))}


def share_words(share: ShareSummary) -> str:
    """A share with its interval, `99.30 % (98.56 to 99.72 %)`."""
    low, high = share["ci95"]
    return f"{100 * share['share']:.2f} % ({100 * low:.2f} to {100 * high:.2f} %)"


def verdict(result: TuningOutcome) -> VerdictSummary:
    """Whether all hard goals and all rigs are held, and if not by how much and which."""
    judged = _of_goals(result)
    if not result.rigs:
        return judged
    count, lines = sum(len(rig.cases) for rig in result.rigs), not_held(result.rigs)
    said = f"MISSED in {len(lines)} of {count} cases on the rig: {'; '.join(lines)}"
    if not lines:
        said = f"all {count} cases on the rig are held" if count > 1 else "the case on the rig is held"
    joined = "; ".join(part for part in (judged["said"], said) if part)
    return {**judged, "held": judged["held"] and not lines, "said": joined}


def _of_goals(result: TuningOutcome) -> VerdictSummary:
    """Whether all hard goals are held."""
    found, names = result.found, result.names
    plants = f"{len(names)} plant{'s' * (len(names) > 1)}"
    hard = found.best.hard
    base: VerdictSummary = {"at_least": None, "reached": None, "held": found.feasible, "converged": True, "said": ""}
    drawn = found.drawn
    if found.feasible and drawn is not None:
        share = f"{100 * held_share(drawn):.2f} % of the draws"
        said = f"all {len(hard)} hard goals are held by {plants} and {share}"
        return {**base, "said": f"held: {said}"}
    if found.best.most_missed <= HELD and drawn is not None:
        share = f"{100 * held_share(drawn):.2f} % of {len(drawn.radius)} draws"
        return {
            **base,
            "said": f"INFEASIBLE: the hard goals are held by {share}, {100 * found.share:g} % are asked for",
        }
    if found.feasible:
        said = f"all {len(hard)} hard goals are held by {plants}" if hard else ""
        return {**base, "said": f"held: {said}" if said else ""}
    if not found.best.stable:
        unstable = ", ".join(names[j] for _, j in found.binding)
        return {**base, "said": f"INFEASIBLE: no values make all loops stable; unstable with {unstable}"}
    lines = []
    for i in dict.fromkeys(i for i, _ in found.binding):
        at = [j for goal, j in found.binding if goal == i]
        figures = ", ".join(f"{found.best.figures[i, j]:.4g} with {names[j]}" for j in at)
        lines.append(f"{words(found.best.goals[i])}: {figures}")
    return {**base, "said": "INFEASIBLE: these values miss the goals least; what binds: " + "; ".join(lines)}


def words(goal: Goal) -> str:
    """A goal in words, `gain margin at least 10 dB`."""
    unit = MEASURES[goal.measure].unit
    shown = "" if unit in ("", "1") else f" {unit}"
    text = goal.measure
    if goal.signal is not None:
        text += f" of {goal.signal.name}"
    if goal.relative is not None:
        text += f" over its {goal.relative}" if goal.relative == "peak" else " over the reference"
    if goal.disturbed is not None:
        text += " after a disturbance"
    if goal.opened is not None:
        text += f" at {goal.opened.name}"
    for side, bound in (("at least", goal.lower), ("at most", goal.upper)):
        text += "" if bound is None else f" {side} {bound:g}{shown}"
    return text


def goal_summaries(result: TuningOutcome) -> list[GoalSummary]:
    """All goals with their figures."""
    best, names = result.found.best, result.names
    return [_goal(best, i, names, [j for goal, j in result.found.binding if goal == i]) for i in range(len(best.goals))]


def calibrated(result: TuningOutcome, folder: Path) -> Calibrated:
    """The controller's FMU with the study's values and those that were found."""
    units = {f"{CONTROLLER}.{name}": _unit(result, name) for name in result.found.best.values}
    kept = {name: unit for name, unit in units.items() if unit != "1"}
    return Calibrated({CONTROLLER: result.controller}, result.values, kept)


def _goal(best: CandidateJudgement, number: int, names: tuple[str, ...], binding: list[int]) -> GoalSummary:
    goal, figures = best.goals[number], best.figures[number]
    missed = best.missed[number]
    held = None if goal.minimised else bool(np.all(missed <= HELD))
    return {
        "goal": words(goal),
        "measure": goal.measure,
        "unit": MEASURES[goal.measure].unit,
        "kind": "minimised" if goal.minimised else "hard" if goal.hard else "soft",
        "at_least": goal.lower,
        "at_most": goal.upper,
        "weight": goal.weight,
        "figures": {name: finite(float(value)) for name, value in zip(names, figures, strict=True)},
        "held": held,
        "binding": [names[j] for j in binding],
    }


def _loops(result: Tuning) -> dict[str, LoopSummary]:
    loops = result.problem.trial(result.found.best.values).loops
    found: dict[str, LoopSummary] = {}
    for name, radius, poles in zip(loops.plants.names, loops.radius, loops.poles, strict=True):
        shown = [[float(p.real), float(p.imag)] for p in poles if np.isfinite(p)]
        found[name] = {
            "stable": bool(radius < 1.0),
            "radius": float(np.nan_to_num(radius, posinf=1e308)),
            "poles": shown,
        }
    return found


def _descent(descent: Descent) -> DescentSummary:
    found = descent.found
    return DescentSummary(descent.start, found.values, found.objective, found.feasible, descent.evaluations)


def _parameters(result: TuningOutcome) -> dict[str, ParameterSummary]:
    starts = result.found.starts
    return {
        f"{CONTROLLER}.{name}": {
            "value": value,
            "std": None,
            "ci95": None,
            "unit": _unit(result, name),
            "start": starts.get(name),
        }
        for name, value in result.found.best.values.items()
    }


def _unit(result: TuningOutcome, name: str) -> str:
    return result.interface.ports[name].unit or "1"
