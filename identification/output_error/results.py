"""A calibration by output error as `summary.json` holds it, and what of it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NotRequired

from typing_extensions import TypedDict

from identification.fits import FitSummary
from identification.method import Calibrated
from identification.output_error.calibration import Calibration
from identification.output_error.choice.summary import ChoiceSummary
from identification.output_error.choice.summary import summary as choice_summary
from identification.output_error.chosen_windows import PickedWindows
from identification.output_error.exported.latencies import latency_fmus, latency_notes
from identification.output_error.search.estimate import Estimate, OutputNoise, Shot
from identification.output_error.search.intervals import Bootstrap
from identification.output_error.search.roughness import Roughness
from identification.output_error.verdict import calibration_verdict
from identification.results import ParameterSummary, Summary, data_summary, finite
from identification.signals.excitation import Picked
from orchestrator.crossing import documents_of
from orchestrator.fmi.interface import Value
from orchestrator.results import versions
from orchestrator.trace import FloatArray

GIVEN = (
    "intervals take the model, and whatever is fixed in it, for right: a wrong constant that other parameters make up "
    "for shows nowhere"
)


@dataclass(frozen=True, eq=False)
class NamedCovariance:
    """Covariance (n, n) of the free parameters, in the product of their units; nan beside an undetermined one."""

    parameters: tuple[str, ...]
    matrix: FloatArray


@dataclass(frozen=True, eq=False)
class ProfileSummary:
    """How the least cost rises as a parameter is held beside its estimate, and what the interval would be locally.

    Attributes:
        values, rise: of the curve; in the parameter's unit, and over what noise explains.
        threshold: the rise at the interval's ends.
        open: "lower" or "upper" -> why the interval has no end there.
        local95: the interval by the sensitivities at the estimate.
    """

    values: FloatArray
    rise: FloatArray
    threshold: float
    open: Mapping[str, str]
    local95: tuple[float, float]


class UncertaintySummary(TypedDict):
    """How the intervals came about, and which parameters the data cannot tell apart, or hardly.

    Attributes:
        method: of the covariance.
        intervals: local, profile or bootstrap.
        noise: by output.
        given: what intervals take for right.
    """

    method: str
    intervals: str
    given: str
    noise: dict[str, OutputNoise]
    profiles: NotRequired[dict[str, ProfileSummary]]
    bootstrap: NotRequired[Bootstrap]
    covariance: NamedCovariance
    white_residuals: bool
    singular_values: list[float]
    unseen: list[str]
    weak: list[str]


class SearchSummary(TypedDict):
    """What the search took, and the first few reasons of simulations that failed."""

    converged: bool
    message: str
    iterations: int
    evaluations: int
    simulations: int
    failures: int
    differences: str
    reasons: list[str]
    rough: NotRequired[Mapping[str, Roughness]]
    shooting: NotRequired[Shot]


class WindowsSummary(TypedDict):
    """How recordings have chosen windows: their length [s] and in communication steps, by which period [s]."""

    length: float
    steps: int
    period: float
    traces: Mapping[str, Picked]


class OutputErrorSummary(Summary):
    """The summary of an output-error calibration.

    Attributes:
        candidate: the one that was chosen, where a study has some; `choice` tells of all.
    """

    uncertainty: UncertaintySummary
    search: SearchSummary
    candidate: NotRequired[str]
    choice: NotRequired[ChoiceSummary]
    windows: NotRequired[WindowsSummary]


def _below_means(train: FitSummary) -> list[str]:
    """A sentence about each output that the best fit follows less than a constant would."""
    return [
        f"{name} is followed less well than by its own mean (FIT {fit:.2g}): the signal may be another one, of the "
        "other sign, or in another unit, or the model is not what was recorded"
        for name, fit in train.get("outputs", {}).items()
        if fit is not None and fit < 0
    ]


def summary(calibration: Calibration) -> OutputErrorSummary:
    """The calibration as `summary.json` holds it; what is not determined is null."""
    study, found = calibration.study, calibration.estimate
    made: OutputErrorSummary = {
        "title": study.title,
        "method": "output-error",
        "parameters": {name: _parameter(calibration, name) for name in found.values},
        "fit": {
            "train": calibration.train.summary,
            "validation": calibration.validation.summary if calibration.validation else None,
            "compared": {name: judged.summary for name, judged in calibration.compared.items()},
        },
        "uncertainty": _uncertainty(found),
        "search": {
            "converged": found.converged,
            "message": found.message,
            "iterations": found.iterations,
            "evaluations": found.tally.evaluations,
            "simulations": found.tally.simulations,
            "failures": found.tally.failures,
            "differences": found.tally.differences,
            "reasons": list(found.tally.reasons),
        },
        "data": data_summary(calibration.recorded, study.traces.hold_out),
        "units": documents_of(calibration.crossings),
        "versions": versions(),
        "warnings": [*calibration.warnings, *_below_means(calibration.train.summary), *latency_notes(calibration)],
        "verdict": calibration_verdict(calibration),
    }
    if calibration.choice is not None:
        made["candidate"] = calibration.choice.chosen
        made["choice"] = choice_summary(calibration.choice)
    if found.rough:
        made["search"]["rough"] = found.rough
    if found.shot is not None:
        made["search"]["shooting"] = found.shot
    if calibration.picked is not None:
        made["windows"] = _windows(calibration.picked, study.run.step)
    return made


def _windows(picked: PickedWindows, step: Fraction) -> WindowsSummary:
    length = picked.length
    return {
        "length": float(length.seconds),
        "steps": int(length.seconds / step),
        "period": length.period,
        "traces": picked.traces,
    }


def windows_words(windows: WindowsSummary) -> str:
    """How windows were chosen, in a line."""
    picked = windows["traces"].values()
    taken, still, less = (sum(getattr(one, key) for one in picked) for key in ("taken", "still", "less"))
    left = [f"{still} are still"] * bool(still) + [f"{less} move less than those that are"] * bool(less)
    return (
        f"windows of {windows['length']:.4g} s are chosen by the recordings, whose strongest oscillation lasts "
        f"{windows['period']:.3g} s: {taken} of {taken + still + less} taken{', ' if left else ''}{', '.join(left)}"
    )


def shooting_words(shot: Shot) -> str:
    """What became of segments, in a line."""
    joined = "have joined" if shot.joined else "have NOT joined"
    return (
        f"the search began with windows in {shot.segments} segments, which {joined}: the largest gap is "
        f"{shot.gap:.1g} of a state's size, and whole windows make {shot.growth:.2g} times as much of a deviation"
    )


def _uncertainty(found: Estimate) -> UncertaintySummary:
    made: UncertaintySummary = {
        "method": found.uncertainty.method,
        "intervals": found.intervals.by,
        "given": GIVEN,
        "noise": {one.output: one for one in found.noise},
        "covariance": NamedCovariance(found.free, found.covariance),
        "white_residuals": found.uncertainty.is_white,
        "singular_values": found.identifiability.singular_values.tolist(),
        "unseen": [combination.message for combination in found.identifiability.unseen],
        "weak": [combination.message for combination in found.identifiability.weak],
    }
    if found.intervals.profiles:
        made["profiles"] = {
            name: ProfileSummary(curve.values, curve.rise, curve.threshold, curve.open, found.local95[name])
            for name, curve in found.intervals.profiles.items()
        }
    if found.intervals.bootstrap is not None:
        made["bootstrap"] = found.intervals.bootstrap
    return made


def calibrated(calibration: Calibration, folder: Path) -> Calibrated:
    """The system's FMUs with the study's values, the estimates and the study's step, and those that bring latencies;
    and all values but delays."""
    study, found = calibration.study, calibration.estimate.values
    members = {member for one in study.grouped for member in one.members.values()}
    values = {name: value for name, value in found.items() if "." in name and name not in members}
    groups: dict[str, dict[str, Value]] = {}
    for one in study.grouped:
        for group, member in one.members.items() if "." in one.variable else ():
            values.setdefault(one.variable, found[member])
            groups.setdefault(group, {})[one.variable] = found[member]
    known = {study.variable(name): unit for name, unit in calibration.units.items()}
    units = {name: unit for name, unit in known.items() if name in values and unit != "1"}
    system = calibration.system
    fmus = {**system.calibrated(values, float(study.run.step)), **latency_fmus(calibration, folder)}
    return Calibrated(fmus, system.changed(values), units, groups)


def _parameter(calibration: Calibration, name: str) -> ParameterSummary:
    found, study = calibration.estimate, calibration.study
    starts = {parameter.name: parameter.start for parameter in study.parameters.parameters}
    entry: ParameterSummary = {
        "value": found.values[name],
        "std": finite(found.std[name]) if name in found.std else None,
        "ci95": [finite(end) for end in found.ci95[name]] if name in found.ci95 else None,
        "unit": calibration.units.get(name, "1"),
        "start": starts.get(name),
    }
    truth = study.truth.get(name, study.truth.get(study.variable(name)))
    if truth is not None:
        entry["truth"] = truth
    if (variable := study.variable(name)) != name:
        entry["of"] = variable
    if (known := found.known.get(name)) is not None:
        entry["prior"] = known
    return entry
