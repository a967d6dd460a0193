"""An inverse-dynamics identification as `summary.json` holds it, and what of it is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typing_extensions import TypedDict

from identification.fits import FitSummary, fit_summary
from identification.inverse_dynamics.calibration import InverseCalibration, Regressed
from identification.method import Calibrated
from identification.recordings.units import unit_documents
from identification.results import ParameterSummary, Summary, VerdictSummary, data_summary, parameter_summary, verdict
from orchestrator.results import versions


class WaySummary(TypedDict):
    """What one way gave, by component.parameter, and how many rounds of the loop it took (0 for least squares)."""

    parameters: dict[str, ParameterSummary]
    rounds: int


class InverseSummary(Summary):
    """The summary of an inverse-dynamics identification; FIT there is of the force, not of free runs.

    Attributes:
        found: way -> what it gave.
        compare: name -> component.parameter -> value of others.
    """

    found: dict[str, WaySummary]
    compare: dict[str, dict[str, float]]


def summary(result: InverseCalibration) -> InverseSummary:
    """The identification as `summary.json` holds it; what is not determined is null."""
    study = result.study
    return {
        "title": study.title,
        "method": f"inverse-dynamics ({study.take})",
        "parameters": _parameters(result, result.taken),
        "found": {
            way: {"parameters": _parameters(result, found), "rounds": found.rounds}
            for way, found in result.found.items()
        },
        "compare": {name: dict(values) for name, values in study.compare.items()},
        "fit": {
            "train": _fit(result.fits(aside=False)),
            "validation": _fit(result.fits(aside=True)) if study.traces.hold_out else None,
        },
        "data": data_summary(result.recorded, study.traces.hold_out),
        "units": unit_documents(result.recorded),
        "versions": versions(),
        "warnings": result.warnings,
        "verdict": inverse_verdict(result),
    }


def inverse_verdict(result: InverseCalibration) -> VerdictSummary:
    """Whether the rounds came to an end."""
    taken = result.taken
    unsettled = "" if taken.settled else f"the values still change after {taken.rounds} rounds; `take: least-squares`"
    return verdict(_fit(result.fits(aside=False)), "force", None, unsettled=unsettled, recorded=result.recorded)


def calibrated(result: InverseCalibration, folder: Path) -> Calibrated:
    """The system's FMUs with the study's values and the new ones."""
    taken, write = result.taken.parameters, result.study.write
    values = {target: taken[term].value for term, target in write.items()}
    units = {target: taken[term].unit for term, target in write.items() if taken[term].unit}
    return Calibrated(result.system.calibrated(values), values, units)


def _parameters(result: InverseCalibration, found: Regressed) -> dict[str, ParameterSummary]:
    names, truth = result.study.write, result.study.truth
    return {
        names[term]: parameter_summary(one, result.before[term], truth.get(names[term]))
        for term, one in found.parameters.items()
    }


def _fit(fits: dict[str, float]) -> FitSummary:
    names = list(fits)
    return fit_summary(np.array(list(fits.values()))[:, None], names, names, ["force"])
