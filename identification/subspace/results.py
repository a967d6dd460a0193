"""What a subspace study leaves: the model as an FMU, its summary and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import TypedDict

from fmus.models.state_space import matrices
from fmus.packaging import linear
from identification.linear.mode_tracking import Spread, spreads, stabilisation
from identification.linear.model import LinearModel
from identification.linear.modes import labels, modes, ranked
from identification.method import Calibrated, CalibratedFmu
from identification.recordings.campaign import recording_warnings
from identification.results import FitsSummary, FitSummary, Summary, data_summary, finite, provenance
from identification.subspace.calibration import Candidate, SubspaceCalibration, settings_of
from identification.subspace.orders import borne
from identification.subspace.prediction_error import uncertainty
from identification.subspace.subspace import scan
from orchestrator.report import Report, Section, figures
from orchestrator.report.blocks import Cell
from orchestrator.results import versions
from orchestrator.trace import FloatArray, Trace

SHOWN = 4  # traces with their free runs
SCANNED = 30  # highest order of the stabilisation diagram


def calibrated(result: SubspaceCalibration, folder: Path) -> Calibrated:
    """The model as a `state_space` FMU."""
    name = result.study.name
    return Calibrated({name: linear_fmu(result.taken.model, folder / f"{name}.fmu", units_of(result))})


def linear_fmu(model: LinearModel, path: Path, units: Mapping[str, str] | None = None) -> CalibratedFmu:
    """A `state_space` FMU of a model's size, built at this path, and the matrices that go into it."""
    direct = model.d if np.any(model.d) else None
    return CalibratedFmu(linear.build(model, path, units), matrices(model.a, model.b, model.c, direct))


def units_of(result: SubspaceCalibration) -> dict[str, str]:
    """Units of the model's inputs and outputs, as the traces have them."""
    first = result.recorded[0].trace
    return {name: first.units.get(name, "1") for name in (*result.study.inputs, *result.study.outputs)}


class ModeSummary(TypedDict):
    """A mode of a model: label, frequency [Hz], damping ratio, their standard deviations, eigenvalue [re, im]."""

    mode: str
    frequency: float | None
    damping: float | None
    frequency_std: float | None
    damping_std: float | None
    eigenvalue: list[float]


class ModelSummary(TypedDict):
    """A model of a subspace study; `matrices` holds a, b, c and d, `step` is in seconds."""

    order: int
    why: str
    stable: bool
    fit: FitsSummary
    modes: list[ModeSummary]
    matrices: dict[str, list[list[float]]]
    step: float


class SubspaceSummary(Summary):
    """The summary of a subspace study; `models` by their names."""

    models: dict[str, ModelSummary]


def summary(result: SubspaceCalibration) -> SubspaceSummary:
    """The study as `summary.json` holds it."""
    taken, study = result.taken, result.study
    return {
        "title": study.title,
        "method": f"subspace ({taken.name})",
        "parameters": {},
        "models": {name: _model(result, candidate) for name, candidate in result.candidates.items()},
        "fit": {
            "train": _fits(result, taken, taken.train, fitted=True),
            "validation": _fits(result, taken, taken.unseen, fitted=False) if len(taken.unseen) else None,
        },
        "data": data_summary(result.recorded, study.traces.hold_out),
        "versions": versions(),
        "warnings": warnings_of(result),
    }


def report(result: SubspaceCalibration) -> Report:
    """FIT by model, free runs, modes and where they stay, singular values, provenance."""
    page = Report(result.study.title, result.study.description)
    section = page.section("Result")
    for warning in warnings_of(result):
        section.callout("warning", warning)
    section.table(*fit_table(result), caption="Median FIT over the traces, free runs")
    _free_runs(page.section("Free runs"), result)
    _modes(page.section("Modes"), result)
    _extraction(page.section("Singular values"), result)
    provenance(page.section("Provenance"), data_summary(result.recorded, result.study.traces.hold_out))
    return page


def fit_table(result: SubspaceCalibration) -> tuple[list[str], list[list[Any]]]:
    """Headers and rows: each model's order and its median FIT of each output, on fitted and on unseen traces."""
    outputs = result.study.outputs
    headers = ["model", "order", *(f"{name}, fitted" for name in outputs), *(f"{name}, unseen" for name in outputs)]
    rows = [
        [name, each.model.order, *_medians(each.train), *(_medians(each.unseen) or [None] * len(outputs))]
        for name, each in result.candidates.items()
    ]
    return headers, rows


def _medians(fit: FloatArray) -> list[float | None]:
    """By output, over traces."""
    return [finite(float(np.nanmedian(column))) for column in fit.T] if len(fit) else []


def _fits(result: SubspaceCalibration, candidate: Candidate, fit: FloatArray, *, fitted: bool) -> FitSummary:
    kept = set(result.study.traces.hold_out)
    names = [each.trace.name for each in result.recorded if (each.trace.name not in kept) == fitted]
    by_trace = {name: finite(float(np.nanmedian(row))) for name, row in zip(names, fit, strict=True)}
    by_output = dict(zip(result.study.outputs, _medians(fit), strict=True))
    return {"median": finite(float(np.nanmedian(fit))), "windows": len(fit), "traces": by_trace, "outputs": by_output}


def _model(result: SubspaceCalibration, candidate: Candidate) -> ModelSummary:
    model = candidate.model
    return {
        "order": model.order,
        "why": candidate.why,
        "stable": model.stable,
        "fit": {
            "train": _fits(result, candidate, candidate.train, fitted=True),
            "validation": _fits(result, candidate, candidate.unseen, fitted=False) if len(candidate.unseen) else None,
        },
        "modes": _mode_entries(model, _spreads(result, candidate)),
        "matrices": {name: getattr(model, name).tolist() for name in "abcd"},
        "step": model.step,
    }


def _spreads(result: SubspaceCalibration, candidate: Candidate) -> Sequence[Spread | None]:
    """Uncertainty of the modes, which only the refined model has."""
    if candidate.name != "refined" or result.refined is None:
        return [None] * candidate.model.order
    refined = result.refined
    return spreads(refined.model, refined.directions.a, uncertainty(refined).matrix)


def _mode_entries(model: LinearModel, spread: Sequence[Spread | None]) -> list[ModeSummary]:
    found = modes(model)
    return [
        {
            "mode": label,
            "frequency": finite(mode.frequency),
            "damping": finite(mode.damping),
            "frequency_std": finite(known.frequency) if known else None,
            "damping_std": finite(known.damping) if known else None,
            "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
        }
        for label, mode, known in zip(labels(found), found, spread, strict=False)
    ]


def warnings_of(result: SubspaceCalibration) -> list[str]:
    """What a reader of the figures must know."""
    taken, found = result.taken, result.subspaces[result.study.weightings[0]]
    warnings = []
    if not taken.model.stable:
        warnings.append("the model is unstable; ask for `poles: stable`, or for another order")
    if found.dropped:
        warnings.append(f"{found.dropped} pieces between gaps were too short, {found.lost} samples are left out")
    if result.refined is not None and not result.refined.converged:
        warnings.append(f"the refinement did not converge: {result.refined.why}")
    return [*warnings, *recording_warnings(result.recorded)]


def _free_runs(section: Section, result: SubspaceCalibration) -> None:
    kept = [name for name in result.records if name in result.study.traces.hold_out]
    shown = (kept or list(result.records))[:SHOWN]
    section.paragraph("Traces kept out of the fit." if kept else "Traces of the fit; none was kept out of it.")
    for name in shown:
        record = result.records[name]
        time = record.step * np.arange(len(record), dtype=float)
        curves = [
            (candidate.name, Trace(time, dict(zip(record.outputs, candidate.runs[name].T, strict=True)), {}, name))
            for candidate in _drawn(result)
        ]
        measured = Trace(time, dict(zip(record.outputs, record.y.T, strict=True)), {}, name)
        section.figure(figures.overlay(measured, curves), name)


def _drawn(result: SubspaceCalibration) -> list[Candidate]:
    """The model that is written, and the first weighting's."""
    first = result.candidates[result.study.weightings[0]]
    return [result.taken] if result.taken is first else [first, result.taken]


def _modes(section: Section, result: SubspaceCalibration) -> None:
    model = result.taken.model
    found = modes(model)
    u = np.concatenate([record.u for record in result.records.values()])
    magnitudes = ranked([mode.response_magnitude(u) for mode in found])
    values = ranked([mode.mode_singular_value(len(u)) for mode in found])
    entries = _mode_entries(model, _spreads(result, result.taken))
    rows = [
        [
            entry["mode"],
            entry["frequency"],
            _half(entry["frequency_std"]),
            entry["damping"],
            _half(entry["damping_std"]),
            by_mrm,
            by_msv,
        ]
        for entry, by_mrm, by_msv in zip(entries, magnitudes, values, strict=True)
    ]
    headers = ["mode", "frequency [Hz]", "± 95 %", "damping", "± 95 %", "MRM rank", "MSV rank"]
    section.table(headers, rows, caption=f"Modes of the model that is written ({result.taken.name})")
    section.figure(_stabilisation(result), "Stabilisation diagram: a mode of the system stays from order to order")


def _half(std: float | None) -> float | None:
    return None if std is None else 1.96 * std


def _stabilisation(result: SubspaceCalibration) -> Any:
    first = result.subspaces[result.study.weightings[0]]
    most = borne(first.singular_values, min(SCANNED, (result.study.block - 1) * len(result.study.outputs)))
    settings = replace(settings_of(result.study, result.study.weightings[0]), poles="free")
    sightings = stabilisation([each.model for each in scan(first.records, range(2, most + 1), settings)])
    nyquist = 0.5 / first.model.step
    groups = {
        "stable": [s for s in sightings if s.stable],
        "in frequency": [s for s in sightings if s.in_frequency and not s.stable],
        "new": [s for s in sightings if not s.in_frequency],
    }
    points = {name: ([s.mode.frequency for s in each], [float(s.order) for s in each]) for name, each in groups.items()}
    return figures.points(points, "frequency [Hz]", "order", limit=nyquist)


def _extraction(section: Section, result: SubspaceCalibration) -> None:
    curves = {
        name: (list(range(1, len(each.singular_values) + 1)), (each.singular_values / each.singular_values[0]).tolist())
        for name, each in result.subspaces.items()
    }
    section.figure(figures.points(curves, "number", "singular value, relative", logarithmic=True))
    rows: list[list[Cell]] = [
        [name, each.condition, each.compression, each.excitation] for name, each in result.subspaces.items()
    ]
    section.table(["weighting", "condition of the data", "compressed by", "condition of the input"], rows)
