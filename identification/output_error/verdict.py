"""Whether a calibration is what its study asks for, and what to do where it is not, in a line."""

from __future__ import annotations

from collections.abc import Iterator

from identification.estimation.parameters import Parameter
from identification.output_error.calibration import Calibration
from identification.output_error.search.estimator import APART, DEPARTED, SILENT
from identification.results import VerdictSummary, verdict

_WIDE = 10.0  # largest over smallest value allowed, from which a logarithmic scale serves better


def calibration_verdict(calibration: Calibration) -> VerdictSummary:
    """By the traces kept aside, where there are none by the fitted ones."""
    judged, side = calibration.validation, "unseen"
    if judged is None:
        judged, side = calibration.train, "fitted (no trace was held out)"
    found = calibration.estimate
    if calibration.stopped:
        unjudged = f"; the values are those of iteration {found.iterations}, not validated"
        said = f"STOPPED, {calibration.stopped}{'' if calibration.choice else unjudged}"
        target = calibration.study.at_least
        return {"at_least": target, "reached": None, "held": False, "converged": found.converged, "said": said}
    unsettled = "" if found.converged else f"{found.message}; try {', '.join(_remedies(calibration))}"
    found_nothing = found.message.startswith(SILENT)
    judgement = verdict(
        judged.summary,
        side,
        calibration.study.at_least,
        worst_at_least=calibration.study.worst_at_least,
        unsettled=unsettled,
        remedy=_remedy(calibration),
        recorded=calibration.recorded,
    )
    return {**judgement, "held": judgement["held"] and not found_nothing}


def _remedies(calibration: Calibration) -> Iterator[str]:
    """What may bring a search to its end, the likeliest first."""
    found, study = calibration.estimate, calibration.study
    seen = found.identifiability
    if found.message.startswith(SILENT):
        yield "`fixed: true`, a recording that excites what depends on it, or wider `min` and `max`"
        return
    if found.message == APART:
        yield "more and shorter segments (`shooting`)"
    if found.message == DEPARTED:
        yield "shorter `windows`"
        return
    if "evaluations" in found.message or "iterations" in found.message:
        yield f"`options.max_evaluations` above {study.options.max_evaluations}"
    if found.tally.failures:
        yield "narrower `min` and `max`, where all runs succeed"
    tangles = [combination.coefficients for combination in (*seen.unseen, *seen.weak)]
    entangled = dict.fromkeys(name for names in tangles if len(names) > 1 for name in names)
    if entangled:
        yield f"`fixed: true` for one of {', '.join(entangled)}"
    wide = [parameter.name for parameter in study.parameters.free if _is_wide(parameter)]
    if wide:
        yield f"`scale: log` for {', '.join(wide)}"
    if "however short" in found.message:
        yield f"`options.difference_step` above {study.options.difference_step:g}"
    yield "other `start` values (or several: `options.starts`)"


def _is_wide(parameter: Parameter) -> bool:
    return parameter.scale == "linear" and 0 < _WIDE * parameter.lower < parameter.upper


def _remedy(calibration: Calibration) -> str:
    """What may raise FIT."""
    read = [name for name, spec in calibration.study.run.initial.items() if not spec.estimated]
    advice = "see the residuals in the report for what the model leaves out, or free more parameters"
    return f"{advice}, or fit start values (`estimated: true` for {', '.join(read)})" if read else advice
