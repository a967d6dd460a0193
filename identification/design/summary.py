"""A design as `summary.json` holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict

from identification.design.criteria import QUANTILE
from identification.design.design import Design
from identification.design.search import TriedExperiment
from identification.design.study import DurationTrial, Sought
from identification.results import ParameterSummary, Summary, finite
from orchestrator.fmi.interface import Value
from orchestrator.results import versions

SHOWN = 60  # candidates


@dataclass(frozen=True)
class ResponseSummary:
    """What a limited variable is predicted to do, and its limits; infinite where there is none."""

    least: float
    most: float
    above: float
    below: float
    unit: str


class ExperimentSummary(TypedDict):
    """An experiment: its values by component.variable, and how near it comes to the limits.

    Attributes:
        noise: output -> standard deviation of a compared sample.
        alone: the criterion's figure if all experiments were this one; null where it does not show all parameters.
    """

    family: str
    values: dict[str, Value]
    responses: dict[str, ResponseSummary]
    noise: dict[str, float]
    alone: float | None


class HalfWidthSummary(TypedDict):
    """Half-widths of a parameter's 95 % interval: before, after, of other experiments; null where undetermined."""

    unit: str
    before: float | None
    after: float | None
    compared: dict[str, float | None]


class SearchedSummary(TypedDict):
    """What the search took: runs of the rig, what it refused, and the criterion's figure after each round."""

    runs: int
    kept: int
    exceeded: dict[str, int]
    failures: list[str]
    figures: list[float | None]


class DurationSummary(TypedDict):
    """The duration that was sought: what it has to reach, whether it does, and all that were tried.

    Attributes:
        seconds: the shortest of these that does; the longest where none does.
        said: that in a line.
    """

    seconds: float
    target: str
    reached: bool
    tried: Sequence[DurationTrial]
    said: str


class DesignSummary(Summary):
    """The summary of a design.

    Attributes:
        worst: the largest half-width of the parameters that it is about, as a part of the value: after, before (null
            where nothing is known), and of other experiments.
        candidates: the best that were tried, each alone.
    """

    criterion: str
    experiments: dict[str, ExperimentSummary]
    half_widths: dict[str, HalfWidthSummary]
    worst: dict[str, float | None]
    candidates: list[ExperimentSummary]
    search: SearchedSummary
    about: NotRequired[list[str]]
    duration: NotRequired[DurationSummary]


def summary(design: Design) -> DesignSummary:
    """The design in plain values."""
    study, found = design.study, design.found
    ranked = sorted(found.candidates, key=design.alone)[:SHOWN]
    made: DesignSummary = {
        "title": study.title,
        "method": "design",
        "parameters": _parameters(design),
        "fit": {},
        "data": [],
        "versions": versions(),
        "warnings": list(design.remarks),
        "criterion": study.criterion,
        "about": list(study.parameters),
        "experiments": {name: _experiment(design, one) for name, one in design.experiments.items()},
        "half_widths": _half_widths(design),
        "worst": _worst(design),
        "candidates": [_experiment(design, one) for one in ranked],
        "search": {
            "runs": found.runs,
            "kept": len(found.candidates),
            "exceeded": {name: count for name, (count, _) in found.exceeded.items()},
            "failures": list(found.failed),
            "figures": [finite(one) for one in found.figures],
        },
    }
    if study.sought is not None:
        made["duration"] = _duration(design, study.sought)
    return made


def _duration(design: Design, sought: Sought) -> DurationSummary:
    taken = float(design.study.duration)
    [own] = [one.of_target for one in design.trials if one.duration == design.study.duration]
    if not design.reached:
        said = f"MISSED: after {taken:g} s a half-width is {own:.3g} times what was asked for ({sought})"
    else:
        shorter = [float(one.duration) for one in design.trials if one.duration < design.study.duration]
        not_after = f", and not after {max(shorter):g} s" if shorter else ", the least that was allowed"
        said = f"reached after {taken:g} s{not_after}: {sought}"
    return {
        "seconds": taken,
        "target": str(sought),
        "reached": design.reached,
        "tried": design.trials,
        "said": said,
    }


def _parameters(design: Design) -> dict[str, ParameterSummary]:
    found: dict[str, ParameterSummary] = {}
    for name, half in zip(design.names, map(float, design.after), strict=True):
        value, known = design.study.values[name], np.isfinite(half)
        found[name] = {
            "value": value,
            "std": half / QUANTILE if known else None,
            "ci95": [value - half, value + half] if known else None,
            "unit": design.units.get(name, "1"),
            "start": value,
        }
    return found


def _half_widths(design: Design) -> dict[str, HalfWidthSummary]:
    return {
        name: {
            "unit": design.units.get(name, "1"),
            "before": None if design.before is None else finite(float(design.before[row])),
            "after": finite(float(design.after[row])),
            "compared": {other: finite(float(widths[row])) for other, widths in design.compared.items()},
        }
        for row, name in enumerate(design.names)
    }


def _worst(design: Design) -> dict[str, float | None]:
    of = {"after": design.after, "before": design.before, **design.compared}
    return {
        name: None if widths is None else finite(float(design.relative(widths).max())) for name, widths in of.items()
    }


def _experiment(design: Design, candidate: TriedExperiment) -> ExperimentSummary:
    whole, units = candidate.tried.whole, design.units
    return {
        "family": candidate.family,
        "values": dict(candidate.tried.values),
        "responses": {
            name: ResponseSummary(whole[name].min(), whole[name].max(), limit.above, limit.below, units.get(name, ""))
            for name, limit in design.study.limits.items()
        },
        "noise": design.noise(candidate),
        "alone": finite(design.alone(candidate)),
    }
