"""A calibration by output error as `summary.json` holds it, and what of it is written."""

from __future__ import annotations

from pathlib import Path

from typing_extensions import TypedDict

from identification.method import Calibrated
from identification.output_error.calibration import Calibration
from identification.output_error.verdict import calibration_verdict
from identification.results import ParameterSummary, Summary, data_summary, finite
from orchestrator.crossing import documents_of
from orchestrator.results import versions


class CovarianceSummary(TypedDict):
    """Covariance of the free parameters, in the product of their units; null beside one that is not determined."""

    parameters: list[str]
    matrix: list[list[float | None]]


class UncertaintySummary(TypedDict):
    """How the intervals came about, and which parameters the data cannot tell apart, or hardly."""

    method: str
    covariance: CovarianceSummary
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


class OutputErrorSummary(Summary):
    """The summary of an output-error calibration."""

    uncertainty: UncertaintySummary
    search: SearchSummary


def summary(calibration: Calibration) -> OutputErrorSummary:
    """The calibration as `summary.json` holds it; what is not determined is null."""
    study, found = calibration.study, calibration.estimate
    return {
        "title": study.title,
        "method": "output-error",
        "parameters": {name: _parameter(calibration, name) for name in found.values},
        "fit": {
            "train": calibration.train.summary,
            "validation": calibration.validation.summary if calibration.validation else None,
            "compared": {name: judged.summary for name, judged in calibration.compared.items()},
        },
        "uncertainty": {
            "method": found.uncertainty.method,
            "covariance": {
                "parameters": list(found.free),
                "matrix": [[finite(float(value)) for value in row] for row in found.covariance],
            },
            "white_residuals": found.uncertainty.is_white,
            "singular_values": found.identifiability.singular_values.tolist(),
            "unseen": [combination.message for combination in found.identifiability.unseen],
            "weak": [combination.message for combination in found.identifiability.weak],
        },
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
        "warnings": calibration.warnings,
        "verdict": calibration_verdict(calibration),
    }


def calibrated(calibration: Calibration, folder: Path) -> Calibrated:
    """The system's FMUs with the study's values, the estimates and the study's step; and all values but delays."""
    values = {name: value for name, value in calibration.estimate.values.items() if "." in name}
    units = {name: unit for name, unit in calibration.units.items() if name in values and unit != "1"}
    system = calibration.system
    return Calibrated(system.calibrated(values, float(calibration.study.run.step)), system.changed(values), units)


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
    if name in study.truth:
        entry["truth"] = study.truth[name]
    return entry
