"""A calibration by output error as `summary.json` holds it, and what of it is written."""

from __future__ import annotations

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
from identification.output_error.search.estimate import Estimate
from identification.output_error.verdict import calibration_verdict
from identification.results import ParameterSummary, Summary, data_summary, finite
from orchestrator.crossing import documents_of
from orchestrator.fmi.interface import Value
from orchestrator.results import versions

GIVEN = (
    "intervals take the model, and whatever is fixed in it, for right: a wrong constant that other parameters make up "
    "for shows nowhere"
)


class CovarianceSummary(TypedDict):
    """Covariance of the free parameters, in the product of their units; null beside one that is not determined."""

    parameters: list[str]
    matrix: list[list[float | None]]


class ProfileSummary(TypedDict):
    """How the least cost rises as a parameter is held beside its estimate, and what the interval would be locally.

    Attributes:
        values, rise: of the curve; in the parameter's unit, and over what noise explains.
        threshold: the rise at the interval's ends.
        open: "lower" or "upper" -> why the interval has no end there.
        local95: the interval by the sensitivities at the estimate.
    """

    values: list[float]
    rise: list[float]
    threshold: float
    open: dict[str, str]
    local95: list[float | None]


class BootstrapSummary(TypedDict):
    """Fits to windows drawn with replacement, and what intervals were read off them."""

    resamples: int
    failed: int
    seed: int
    kind: str
    std: dict[str, float]


class NoiseSummary(TypedDict):
    """What is left over of an output, taken for noise.

    Attributes:
        std, rounding: its rms, and that of the recording's rounding to steps of `resolution` [unit of the output].
        white: whether tests take it for white.
        why_not: which one does not.
        samples_each: how many samples of it tell as much as one of white noise.
    """

    std: float
    white: bool
    why_not: str
    samples_each: float
    resolution: float
    rounding: float


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
    noise: dict[str, NoiseSummary]
    profiles: NotRequired[dict[str, ProfileSummary]]
    bootstrap: NotRequired[BootstrapSummary]
    covariance: CovarianceSummary
    white_residuals: bool
    singular_values: list[float]
    unseen: list[str]
    weak: list[str]


class RoughnessSummary(TypedDict):
    """Of simulations along a parameter without tangents, whose differences their own noise disturbs.

    Attributes:
        noise: of the outputs by themselves, rms, as a part of what their residuals are weighed by.
        step: of forward differences, as a part of the parameter.
    """

    noise: float
    step: float


class ShootingSummary(TypedDict):
    """What segments of the windows came to, where the search began.

    Attributes:
        gap: the largest left between two of them, in sizes of the states; `joined` where it counts for none.
        growth: how many times as much windows make at most of a deviation at their start.
    """

    segments: int
    joined: bool
    gap: float
    growth: float
    iterations: int
    simulations: int


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
    rough: NotRequired[dict[str, RoughnessSummary]]
    shooting: NotRequired[ShootingSummary]


class PickedSummary(TypedDict):
    """What became of the windows that fit into a recording: taken, still, or with less motion than so many others."""

    taken: int
    still: int
    less: int


class WindowsSummary(TypedDict):
    """How recordings have chosen windows: their length [s] and in communication steps, by which period [s]."""

    length: float
    steps: int
    period: float
    traces: dict[str, PickedSummary]


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
        made["search"]["rough"] = {name: {"noise": one.noise, "step": one.forward} for name, one in found.rough.items()}
    if (shot := found.shot) is not None:
        made["search"]["shooting"] = {
            "segments": shot.segments,
            "joined": shot.closed,
            "gap": shot.gap,
            "growth": shot.growth,
            "iterations": shot.iterations,
            "simulations": shot.simulations,
        }
    if calibration.picked is not None:
        made["windows"] = _windows(calibration.picked, study.run.step)
    return made


def _windows(picked: PickedWindows, step: Fraction) -> WindowsSummary:
    length = picked.length
    return {
        "length": float(length.seconds),
        "steps": int(length.seconds / step),
        "period": length.period,
        "traces": {
            name: {"taken": one.taken, "still": one.still, "less": one.less} for name, one in picked.traces.items()
        },
    }


def windows_words(windows: WindowsSummary) -> str:
    """How windows were chosen, in a line."""
    taken, still, less = (sum(one[key] for one in windows["traces"].values()) for key in ("taken", "still", "less"))
    left = [f"{still} are still"] * bool(still) + [f"{less} move less than those that are"] * bool(less)
    return (
        f"windows of {windows['length']:.4g} s are chosen by the recordings, whose strongest oscillation lasts "
        f"{windows['period']:.3g} s: {taken} of {taken + still + less} taken{', ' if left else ''}{', '.join(left)}"
    )


def shooting_words(shot: ShootingSummary) -> str:
    """What became of segments, in a line."""
    joined = "have joined" if shot["joined"] else "have NOT joined"
    return (
        f"the search began with windows in {shot['segments']} segments, which {joined}: the largest gap is "
        f"{shot['gap']:.1g} of a state's size, and whole windows make {shot['growth']:.2g} times as much of a deviation"
    )


def _uncertainty(found: Estimate) -> UncertaintySummary:
    made: UncertaintySummary = {
        "method": found.uncertainty.method,
        "intervals": found.intervals.by,
        "given": GIVEN,
        "noise": {
            one.output: {
                "std": one.std,
                "white": one.white,
                "why_not": "" if one.white else test.why_not,
                "samples_each": one.samples_each,
                "resolution": one.resolution,
                "rounding": one.rounding,
            }
            for one, test in zip(found.noise, found.uncertainty.whiteness, strict=True)
        },
        "covariance": {
            "parameters": list(found.free),
            "matrix": [[finite(float(value)) for value in row] for row in found.covariance],
        },
        "white_residuals": found.uncertainty.is_white,
        "singular_values": found.identifiability.singular_values.tolist(),
        "unseen": [combination.message for combination in found.identifiability.unseen],
        "weak": [combination.message for combination in found.identifiability.weak],
    }
    if found.intervals.profiles:
        made["profiles"] = {
            name: {
                "values": curve.values.tolist(),
                "rise": curve.rise.tolist(),
                "threshold": curve.threshold,
                "open": dict(curve.open),
                "local95": [finite(end) for end in found.local95[name]],
            }
            for name, curve in found.intervals.profiles.items()
        }
    if (drawn := found.intervals.bootstrap) is not None:
        made["bootstrap"] = {
            "resamples": len(drawn.replicates) + drawn.failed,
            "failed": drawn.failed,
            "seed": drawn.seed,
            "kind": drawn.kind,
            "std": dict(zip(drawn.names, drawn.replicates.std(axis=0, ddof=1).tolist(), strict=True)),
        }
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
        entry["prior"] = {"text": known.text, "source": known.source, "added": known.added, "off": known.off}
    return entry
