"""What a subspace study leaves beside its report: the model as an FMU, and its summary."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict

from fmus.errors import IdentificationError
from identification.fits import FitSummary, fit_summary, told
from identification.linear.fmu import linear_fmu
from identification.linear.modes import modes
from identification.linear.reduction import Reduction
from identification.linear.summary import ModelSummary, ModeSummary, mode_summaries, model_summary
from identification.method import Calibrated
from identification.recordings.campaign import recording_warnings
from identification.recordings.units import unit_documents
from identification.results import FitsSummary, Summary, VerdictSummary, data_summary, finite, verdict
from identification.subspace.calibration import SubspaceCalibration
from identification.subspace.trials import ModelCandidate, SubspaceTrial
from orchestrator.display.table import Cell
from orchestrator.results import versions
from orchestrator.trace import FloatArray


class UncertainModeSummary(ModeSummary):
    """A mode with standard deviations, and its eigenvalue [re, im]."""

    frequency_std: float | None
    damping_std: float | None
    eigenvalue: list[float]


class LinearModelSummary(ModelSummary):
    """A model, why it has its order, and how it did."""

    why: str
    stable: bool
    fit: FitsSummary
    modes: list[UncertainModeSummary]


class SubspaceTrialSummary(TypedDict):
    """A way that was tried: its order and mean FIT of the traces that models are compared on, or why it failed."""

    weighting: str
    block: int
    poles: str
    feedthrough: bool
    order: int | None
    fit: float | None
    problem: str


class OffsetsSummary(TypedDict):
    """Where a model has its zero: signal -> value, of inputs and of outputs."""

    inputs: dict[str, float]
    outputs: dict[str, float]


class SubspaceSummary(Summary):
    """The summary of a subspace study; `models` by their names, `written` the one in the FMU.

    Attributes:
        changes: what one standard deviation changes in the written model's matrices a, b, c and d, along axes that are
            independent of each other; only of a refined model.
    """

    models: dict[str, LinearModelSummary]
    written: str
    tried: list[SubspaceTrialSummary]
    offsets: OffsetsSummary | None
    reduction: Reduction | None
    changes: NotRequired[list[dict[str, list[list[float]]]]]


def summary(result: SubspaceCalibration) -> SubspaceSummary:
    """The study as `summary.json` holds it."""
    taken, study = result.taken, result.study
    document: SubspaceSummary = {
        "title": study.title,
        "method": f"subspace ({taken.name})",
        "parameters": {},
        "models": {name: _model(result, candidate) for name, candidate in result.candidates.items()},
        "written": taken.name,
        "tried": [_trial(trial) for trial in result.trials],
        "offsets": _offsets(result),
        "reduction": result.reduction,
        "fit": fits_of(result, taken),
        "data": data_summary(result.recorded, study.traces.held_out),
        "units": unit_documents(result.recorded),
        "versions": versions(),
        "warnings": warnings_of(result),
        "verdict": subspace_verdict(result),
    }
    if taken.changes:
        document["changes"] = [model_summary(one)["matrices"] for one in taken.changes]
    return document


def _trial(trial: SubspaceTrial) -> SubspaceTrialSummary:
    model, settings = trial.candidate, trial.settings
    return {
        "weighting": settings.weighting,
        "block": settings.block,
        "poles": settings.poles,
        "feedthrough": settings.feedthrough,
        "order": None if model is None else model.model.order,
        "fit": None if model is None else finite(model.score),
        "problem": "" if trial.error is None else str(trial.error),
    }


def _offsets(result: SubspaceCalibration) -> OffsetsSummary | None:
    known = result.zero
    if known is None:
        return None
    inputs, outputs = result.study.inputs, result.study.outputs
    return {
        "inputs": dict(zip(inputs, known.u.tolist(), strict=True)),
        "outputs": dict(zip(outputs, known.y.tolist(), strict=True)),
    }


def subspace_verdict(result: SubspaceCalibration) -> VerdictSummary:
    """Whether the model that is written reaches the study's target, and the refinement its end."""
    if result.stopped:
        said = f"STOPPED, {result.stopped}; the best model until then is written"
        return {"at_least": result.study.at_least, "reached": None, "held": False, "converged": False, "said": said}
    fits, refined = fits_of(result, result.taken), result.refined
    judged, side = fits["validation"], "unseen"
    if judged is None:
        judged, side = fits["train"], "fitted (no trace was held out)"
    unsettled = ""
    if refined is not None and result.taken.name == "refined" and not refined.converged:
        unsettled = f"the refinement {refined.why}; try another `order`, or other `weightings` to start from"
    remedy = "try another `order` or a larger `block`"
    target, recorded = result.study.at_least, result.recorded
    return verdict(
        judged,
        side,
        target,
        worst_at_least=result.study.worst_at_least,
        unsettled=unsettled,
        remedy=remedy,
        recorded=recorded,
    )


def calibrated(result: SubspaceCalibration, folder: Path) -> Calibrated:
    """The model as a `state_space` FMU."""
    study, first = result.study, result.recorded[0].trace
    units = {name: first.units.get(name, "1") for name in (*study.inputs, *study.outputs)}
    return Calibrated({study.name: linear_fmu(result.taken.model, folder / f"{study.name}.fmu", units, result.zero)})


def model_rows(document: SubspaceSummary) -> tuple[list[str], list[list[Cell]]]:
    """Headers and rows: order and median FIT of each output, on fitted and on unseen traces, of every model, and the
    worst of the traces that models are compared on."""
    outputs = list(document["fit"]["train"]["outputs"])
    rows: list[list[Cell]] = []
    for name, model in document["models"].items():
        fits = (model["fit"]["train"], model["fit"]["validation"])
        values = [fit["outputs"][output] if fit else None for fit in fits for output in outputs]
        rows.append([name, model["order"], *values, told((fits[1] or fits[0]).get("worst"))])
    return ["model", "order", *(f"{name}, {side}" for side in ("fitted", "unseen") for name in outputs), "worst"], rows


def fits_of(result: SubspaceCalibration, candidate: ModelCandidate) -> FitsSummary:
    """How a model runs along fitted traces and along those kept aside."""
    aside = _fit(result, candidate.unseen, aside=True) if len(candidate.unseen) else None
    return {"train": _fit(result, candidate.train, aside=False), "validation": aside}


def _fit(result: SubspaceCalibration, fit: FloatArray, *, aside: bool) -> FitSummary:
    held_out = result.study.traces.held_out
    pieces = {name: trace for name, trace in result.pieces.items() if (trace in held_out) == aside}
    return fit_summary(fit, list(pieces), list(pieces.values()), result.study.outputs)


def _model(result: SubspaceCalibration, candidate: ModelCandidate) -> LinearModelSummary:
    model = candidate.model
    return {
        **model_summary(model),
        "why": candidate.why,
        "stable": model.stable,
        "fit": fits_of(result, candidate),
        "modes": uncertain_modes(candidate),
    }


def uncertain_modes(candidate: ModelCandidate) -> list[UncertainModeSummary]:
    """The modes of a model with what is known of their uncertainty; none where it has no modal coordinates."""
    model = candidate.model
    try:
        modes(model)
    except IdentificationError:
        return []
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
    taken, found = result.taken, result.best.result
    warnings = list(result.failures)
    if not taken.model.stable:
        warnings.append("the model is unstable; ask for `poles: stable`, or for another order")
    if found is not None and (pieces := found.space.pieces).dropped:
        warnings.append(f"{pieces.dropped} pieces between gaps were too short, {pieces.lost} samples are left out")
    if result.dropped:
        warnings.append(f"pieces between marks are too short: {result.dropped} samples are left out for that")
    return [*warnings, *_not_finite(result), *recording_warnings(result.recorded)]


def _not_finite(result: SubspaceCalibration) -> Iterator[str]:
    """Of which recordings stretches are left out because a signal has no value there."""
    for known in result.recorded:
        names = [*result.study.inputs, *result.study.outputs]
        missing = [name for name in names if not np.isfinite(known.trace[name]).all()]
        if missing:
            lost = ~np.isfinite(np.column_stack([known.trace[name] for name in missing])).all(axis=1)
            told = f"{int(lost.sum())} samples have no value of {' or '.join(missing)}"
            yield f"{known.trace.name}: {told} and are left out, what lies between counts as records of its own"
