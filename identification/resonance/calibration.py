"""A study by the pendulum thesis' Steps 1-4, from its file to parameters: as published and corrected side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.built_system import BuiltSystem
from identification.method import Calibrated
from identification.quantities import must_be_in
from identification.recordings.campaign import StudyTrace, load_campaign, recording_warnings
from identification.recordings.units import in_units, unit_documents
from identification.resonance import steps
from identification.resonance.added_mass import UNITS
from identification.resonance.steps import LoadResult, ResonanceStudy
from identification.resonance.study import CampaignStudy
from identification.result_sections import provenance
from identification.results import ParameterSummary, Summary, data_summary, parameter_summary
from orchestrator.assembly.assembly import OpenSystem
from orchestrator.crossing import named
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.report import Report, Section, figures
from orchestrator.results import versions
from orchestrator.settable import check_values
from orchestrator.system import must_be
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class ResonanceCalibration:
    """What a study gave by either method."""

    study: CampaignStudy
    recorded: tuple[StudyTrace, ...]
    published: ResonanceStudy
    corrected: ResonanceStudy
    system: BuiltSystem

    @property
    def taken(self) -> ResonanceStudy:
        """The one whose parameters are written back."""
        return self.published if self.study.take == "published" else self.corrected


def calibrate(
    study: CampaignStudy, data: Path | None = None, progress: Progress = silent, isolation: Isolation | None = None
) -> ResonanceCalibration:
    """Steps 1-4 on the study's traces.

    Args:
        data: the recordings, over the study's own.
        isolation: of FMUs whose runs are the recordings.

    Raises:
        InputError: traces are missing, too short or too few, or a field is not known.
    """
    system = BuiltSystem(study.system)
    _check_targets(study, system)
    loaded = load_campaign(study.traces, data, progress, isolation)
    recorded = in_units(loaded, {study.campaign.signal: named("rad")})
    experiments = [study.campaign.experiment(trace) for trace in recorded]
    signal, processing = study.campaign.signal, study.processing
    published = steps.study_as_published(experiments, processing, study.bounds, signal)
    corrected = steps.study(experiments, processing.window, signal)
    return ResonanceCalibration(study, tuple(recorded), published, corrected, system)


def _check_targets(study: CampaignStudy, system: BuiltSystem) -> None:
    """See that the parameters that the study writes, and their truths, are in its system, and in SI units."""
    with OpenSystem(system.assembled) as opened:
        check_values(opened.system, study.system.values())
        for key, names in (("write", list(study.write.values())), ("truth", list(study.truth))):
            for name in names:
                must_be(opened.system, name, "parameter", key)
        for lumped, name in study.write.items():
            must_be_in(opened.system, "write", name, lumped, UNITS.get(lumped))


class LoadSummary(ParameterSummary):
    """The resonance with one added mass [kg] at a length [m]."""

    added_mass: float
    added_length: float


class ResonanceSummary(Summary):
    """The summary of a study by Steps 1-4.

    Attributes:
        resonance: method -> one entry an added mass.
        lumped: method -> p1 to p4.
    """

    resonance: dict[str, list[LoadSummary]]
    lumped: dict[str, dict[str, ParameterSummary]]


def summary(result: ResonanceCalibration) -> ResonanceSummary:
    """The study as `summary.json` holds it."""
    fits = _agreement(result)
    both = (result.published, result.corrected)
    return {
        "title": result.study.title,
        "method": f"resonance ({result.taken.method})",
        "parameters": _parameters(result),
        "resonance": {found.method: [_load(load) for load in found.loads] for found in both},
        "lumped": {
            found.method: {name: parameter_summary(value) for name, value in found.parameters.items()} for found in both
        },
        "fit": {
            "train": {"median": float(np.median(list(fits.values()))), "traces": {**fits}},
            "validation": None,
        },
        "data": data_summary(result.recorded),
        "units": unit_documents(result.recorded),
        "versions": versions(),
        "warnings": [*result.taken.warnings, *recording_warnings(result.recorded)],
    }


def _parameters(result: ResonanceCalibration) -> dict[str, ParameterSummary]:
    """component.variable -> estimate of each parameter that the study writes."""
    found = result.taken.parameters
    return {
        variable: parameter_summary(found[name], truth=result.study.truth.get(variable))
        for name, variable in result.study.write.items()
        if name in found
    }


def calibrated(result: ResonanceCalibration, folder: Path) -> Calibrated:
    """The system's FMUs with the study's values and the estimates."""
    values = {name: entry["value"] for name, entry in _parameters(result).items()}
    return Calibrated(result.system.calibrated(values), values)


def report(result: ResonanceCalibration) -> Report:
    """Frequency responses, resonances and parameters by both methods."""
    page = Report(result.study.title, result.study.description)
    section, found = page.section("Result"), summary(result)
    section.warnings(found["warnings"])
    _parameter_table(section, result)
    _resonance_table(section, result)
    response = page.section("Frequency response")
    loads = result.corrected.loads
    points = [(f"{1000 * load.added_mass:g} g", load.frequency, load.gain) for load in loads]
    curves = [(f"{1000 * load.added_mass:g} g, fitted", *_curve(load)) for load in loads]
    response.figure(
        figures.frequency_response(points, curves), "Gain by added mass: sine fits, and log|G| least squares"
    )
    provenance(page, found)
    return page


def _load(load: LoadResult) -> LoadSummary:
    return {"added_mass": load.added_mass, "added_length": load.added_length, **parameter_summary(load.resonance)}


def _agreement(result: ResonanceCalibration) -> dict[str, float]:
    """trace -> 1 - relative error of the fitted gain at its frequency."""
    found = {}
    for load in result.corrected.loads:
        model = _gain(load, load.frequency)
        for omega, gain, fitted in zip(load.frequency, load.gain, model, strict=True):
            found[f"{load.added_mass:g} kg, {omega:g} rad/s"] = float(1 - abs(fitted - gain) / gain)
    return found


def _curve(load: LoadResult) -> tuple[FloatArray, FloatArray]:
    omega = np.geomspace(load.frequency.min(), load.frequency.max(), 200)
    return omega, _gain(load, omega)


def _gain(load: LoadResult, omega: FloatArray) -> FloatArray:
    assert load.magnitude is not None
    a0, a1, b0 = load.magnitude.a0.value, load.magnitude.a1.value, load.magnitude.b0.value
    return np.asarray(b0 / np.hypot(a0 - omega**2, a1 * omega))


def _parameter_table(section: Section, result: ResonanceCalibration) -> None:
    rows = []
    for name, value in result.corrected.parameters.items():
        published = result.published.parameters.get(name)
        rows.append([name, published.value if published else None, value.value, value.half, value.unit])
    section.table(["parameter", "as published", "corrected", "± 95 %", "unit"], rows)


def _resonance_table(section: Section, result: ResonanceCalibration) -> None:
    rows = []
    for old, new in zip(result.published.loads, result.corrected.loads, strict=True):
        rows.append([new.added_mass, new.added_length, old.resonance.value, new.resonance.value, new.resonance.half])
    headers = ["added mass [kg]", "at [m]", "as published [rad/s]", "corrected [rad/s]", "± 95 %"]
    section.table(headers, rows, caption="Resonance frequencies (Table 4 of the thesis: Eq. 100 fed with decibels)")
