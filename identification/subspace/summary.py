"""What a subspace study leaves beside its report: the model as an FMU, and its summary."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from identification.linear.fmu import linear_fmu
from identification.linear.modes import modes
from identification.linear.summary import ModelSummary, ModeSummary, mode_summaries, model_summary
from identification.method import Calibrated
from identification.recordings.campaign import recording_warnings
from identification.recordings.units import unit_documents
from identification.results import FitsSummary, FitSummary, Summary, VerdictSummary, data_summary, finite, verdict
from identification.subspace.calibration import Candidate, SubspaceCalibration
from orchestrator.results import versions
from orchestrator.trace import FloatArray


class UncertainModeSummary(ModeSummary):
    """A mode with standard deviations, and its eigenvalue [re, im]."""

    frequency_std: float | None
    damping_std: float | None
    eigenvalue: list[float]


class CandidateSummary(ModelSummary):
    """A model, why it has its order, and how it did."""

    why: str
    stable: bool
    fit: FitsSummary
    modes: list[UncertainModeSummary]


class SubspaceSummary(Summary):
    """The summary of a subspace study; `models` by their names."""

    models: dict[str, CandidateSummary]


def summary(result: SubspaceCalibration) -> SubspaceSummary:
    """The study as `summary.json` holds it."""
    taken, study = result.taken, result.study
    return {
        "title": study.title,
        "method": f"subspace ({taken.name})",
        "parameters": {},
        "models": {name: _model(result, candidate) for name, candidate in result.candidates.items()},
        "fit": _fits(result, taken),
        "data": data_summary(result.recorded, study.traces.hold_out),
        "units": unit_documents(result.recorded),
        "versions": versions(),
        "warnings": warnings_of(result),
        "verdict": subspace_verdict(result),
    }


def subspace_verdict(result: SubspaceCalibration) -> VerdictSummary:
    """Whether the model that is written reaches the study's target, and the refinement its end."""
    fits, refined = _fits(result, result.taken), result.refined
    judged, side = fits["validation"], "unseen"
    if judged is None:
        judged, side = fits["train"], "fitted (no trace was held out)"
    unsettled = ""
    if refined is not None and not refined.converged:
        unsettled = f"the refinement {refined.why}; try another `order`, or another first of `weightings` to start from"
    remedy = "try another `order` or a larger `block`"
    target, recorded = result.study.at_least, result.recorded
    return verdict(judged["median"], side, target, unsettled=unsettled, remedy=remedy, recorded=recorded)


def calibrated(result: SubspaceCalibration, folder: Path) -> Calibrated:
    """The model as a `state_space` FMU."""
    study, first = result.study, result.recorded[0].trace
    units = {name: first.units.get(name, "1") for name in (*study.inputs, *study.outputs)}
    return Calibrated({study.name: linear_fmu(result.taken.model, folder / f"{study.name}.fmu", units)})


def medians(fit: FloatArray) -> list[float | None]:
    """By output, over traces."""
    return [finite(float(np.nanmedian(column))) for column in fit.T] if len(fit) else []


def _fits(result: SubspaceCalibration, candidate: Candidate) -> FitsSummary:
    aside = _fit(result, candidate.unseen, aside=True) if len(candidate.unseen) else None
    return {"train": _fit(result, candidate.train, aside=False), "validation": aside}


def _fit(result: SubspaceCalibration, fit: FloatArray, *, aside: bool) -> FitSummary:
    held_out = result.study.traces.hold_out
    names = [trace for trace in result.pieces.values() if (trace in held_out) == aside]
    rows = {name: fit[[other == name for other in names]] for name in names}
    by_trace = {name: finite(float(np.nanmedian(own))) for name, own in rows.items()}
    by_output = dict(zip(result.study.outputs, medians(fit), strict=True))
    return {"median": finite(float(np.nanmedian(fit))), "windows": len(fit), "traces": by_trace, "outputs": by_output}


def _model(result: SubspaceCalibration, candidate: Candidate) -> CandidateSummary:
    model = candidate.model
    return {
        **model_summary(model),
        "why": candidate.why,
        "stable": model.stable,
        "fit": _fits(result, candidate),
        "modes": uncertain_modes(candidate),
    }


def uncertain_modes(candidate: Candidate) -> list[UncertainModeSummary]:
    """The modes of a model with what is known of their uncertainty."""
    model = candidate.model
    return [
        {
            **entry,
            "frequency_std": finite(known.frequency) if known else None,
            "damping_std": finite(known.damping) if known else None,
            "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
        }
        for entry, mode, known in itertools.zip_longest(mode_summaries(model), modes(model), candidate.spreads)
    ]


def warnings_of(result: SubspaceCalibration) -> list[str]:
    """What a reader of the figures must know."""
    taken, found = result.taken, result.subspaces[result.study.weightings[0]]
    warnings = []
    if not taken.model.stable:
        warnings.append("the model is unstable; ask for `poles: stable`, or for another order")
    pieces = found.space.pieces
    if pieces.dropped:
        warnings.append(f"{pieces.dropped} pieces between gaps were too short, {pieces.lost} samples are left out")
    if result.dropped:
        warnings.append(f"pieces between marks are too short: {result.dropped} samples are left out for that")
    return [*warnings, *recording_warnings(result.recorded)]
