"""A recalibration near a motion as `summary.json` holds it, and what of it is written."""

from __future__ import annotations

from pathlib import Path

from typing_extensions import TypedDict

from identification.method import Calibrated
from identification.motion.balance import UNITS
from identification.motion.calibration import MotionCalibration
from identification.motion.found import Recalibrated
from identification.motion.tube import Tube
from identification.recordings.units import unit_documents
from identification.results import ParameterSummary, Summary, VerdictSummary, data_summary, finite, parameter_summary
from orchestrator.results import versions

NEAR = 0.9  # median FIT from which a generic model is good already


class FoundSummary(TypedDict):
    """What one way gave: p1 to p4 as far as it tells them, ratios, and what is to be known of both."""

    parameters: dict[str, ParameterSummary]
    ratios: dict[str, ParameterSummary]
    remarks: list[str]


class FreeRunsSummary(TypedDict):
    """Free runs in the tube.

    Attributes:
        periods, period: how many periods each lasts, and the motion's [s].
        error: model -> root mean square error over all windows [rad].
        improvement: model -> how many times smaller that is than the generic model's.
        windows: model -> window -> root mean square error [rad].
    """

    periods: float
    period: float
    error: dict[str, float]
    improvement: dict[str, float | None]
    windows: dict[str, dict[str, float]]


class OrbitSummary(TypedDict):
    """The amplitude that the controller was asked for, what each motion came to [rad], and how far off that is."""

    wanted: float
    reached: dict[str, float]
    off: float


class MotionSummary(Summary):
    """The summary of a recalibration near a motion.

    Attributes:
        found: way -> what it gave; refused: way -> why it gave nothing.
        intervals: what those of the energy balance come from; null without one.
        indistinct: what the motions cannot tell apart.
        orbit: null where the study names no controller.
        free_runs: null where none were asked for.
    """

    found: dict[str, FoundSummary]
    refused: dict[str, str]
    intervals: str | None
    indistinct: list[str]
    orbit: OrbitSummary | None
    free_runs: FreeRunsSummary | None


def summary(result: MotionCalibration) -> MotionSummary:
    """The recalibration as `summary.json` holds it; what is not determined is null."""
    tube, taken = result.tube, result.taken
    fits = tube.judged[result.study.take].summary if tube else None
    return {
        "title": result.study.title,
        "method": f"motion ({result.study.take})",
        "parameters": {
            target: parameter_summary(taken.parameters[name], result.generic[name], result.study.truth.get(target))
            for target, name in result.written.items()
        },
        "found": {way: _found(found, result) for way, found in result.found.items()},
        "refused": dict(result.refused),
        "intervals": result.balance.method if result.balance else None,
        "indistinct": list(taken.remarks),
        "orbit": _orbit(result),
        "free_runs": _free_runs(tube) if tube else None,
        "fit": {
            "train": fits or {"median": None, "traces": {}},
            "validation": None,
            "compared": {name: judged.summary for name, judged in (tube.judged if tube else {}).items()},
        },
        "data": data_summary(result.recorded),
        "units": unit_documents(result.recorded),
        "versions": versions(),
        "warnings": result.warnings,
        "verdict": motion_verdict(result),
    }


def _found(found: Recalibrated, result: MotionCalibration) -> FoundSummary:
    return {
        "parameters": {name: parameter_summary(one, result.generic[name]) for name, one in found.parameters.items()},
        "ratios": {name: parameter_summary(one) for name, one in found.ratios.items()},
        "remarks": list(found.remarks),
    }


def _orbit(result: MotionCalibration) -> OrbitSummary | None:
    if result.orbit is None or result.off_orbit is None:
        return None
    reached = {motion.name: motion.amplitude for motion in result.motions}
    return {"wanted": result.orbit.amplitude, "reached": reached, "off": result.off_orbit}


def _free_runs(tube: Tube) -> FreeRunsSummary:
    others = [name for name in tube.judged if name != "generic"]
    return {
        "periods": tube.spec.periods,
        "period": tube.period,
        "error": {name: tube.error(name) for name in tube.judged},
        "improvement": {name: finite(tube.improvement(name)) for name in others},
        "windows": {name: tube.errors(name) for name in tube.judged},
    }


def motion_verdict(result: MotionCalibration) -> VerdictSummary:
    """Whether the recalibrated model runs as much better in the tube as the study asks for, and if not, why."""
    tube, take = result.tube, result.study.take
    at_least = tube.spec.at_least if tube else None
    reached = tube.improvement(take) if tube else None
    held = at_least is None or (reached is not None and reached >= at_least)
    said = [] if tube is None else [_said(tube, take, held)]
    if tube is not None and not held:
        said.append(_why(result, tube))
    if result.orbit is not None and result.off_orbit is not None:
        said.append(f"the motion is {100 * result.off_orbit:+.1f} % off the {result.orbit.amplitude:g} rad asked for")
    found = None if reached is None else finite(reached)
    return {"at_least": at_least, "reached": found, "held": held, "converged": True, "said": "; ".join(said)}


def _said(tube: Tube, take: str, held: bool) -> str:
    said = (
        f"free runs of {tube.spec.periods:g} periods are off by {tube.error('generic'):.3g} rad rms with the generic "
        f"model and {tube.error(take):.3g} rad with the recalibrated one, {tube.improvement(take):.3g} times less"
    )
    if tube.spec.at_least is None:
        return said
    return f"{'held' if held else 'MISSED'}: {said}, at least {tube.spec.at_least:g} asked for"


def _why(result: MotionCalibration, tube: Tube) -> str:
    """What may be behind a recalibrated model that is hardly better."""
    if tube.judged["generic"].median >= NEAR:
        return f"the generic model was near the motion already (median FIT {tube.judged['generic'].median:.3f})"
    if result.study.take != "balance":
        return f"`take: {result.study.take}` tells no friction and is in the controller's unit; take the balance"
    if result.balance is not None and result.balance.method == "stretches":
        return "what is left is none of the model's parameters: the balance of energy is off by more than noise"
    return "the parameters fit the recordings, so these do not hold what moves the free runs: see their overlays"


def calibrated(result: MotionCalibration, folder: Path) -> Calibrated:
    """The system's FMUs with the study's values and the new ones."""
    values = {target: result.taken.parameters[name].value for target, name in result.written.items()}
    units = {target: UNITS[name] for target, name in result.written.items()}
    return Calibrated(result.system.calibrated(values), values, units)
