"""The report of a subspace study: how its models run free, their modes, and where these stay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from identification.linear.mode_tracking import stabilisation
from identification.linear.modes import modes, ranked
from identification.recordings.units import unit_documents
from identification.results import data_summary, provenance, verdict_callout
from identification.subspace.calibration import Candidate, SubspaceCalibration
from identification.subspace.orders import borne
from identification.subspace.realisation import realise
from identification.subspace.summary import medians, subspace_verdict, uncertain_modes, warnings_of
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures
from orchestrator.trace import Trace

SHOWN = 4  # traces with their free runs
SCANNED = 30  # highest order of the stabilisation diagram


def report(result: SubspaceCalibration) -> Report:
    """FIT by model, free runs, modes and where they stay, singular values, provenance."""
    page = Report(result.study.title, result.study.description)
    section = page.section("Result")
    verdict_callout(section, subspace_verdict(result))
    for warning in warnings_of(result):
        section.callout("warning", warning)
    section.table(*fit_table(result), caption="Median FIT over the traces, free runs")
    _free_runs(page.section("Free runs"), result)
    _modes(page.section("Modes"), result)
    _extraction(page.section("Singular values"), result)
    data = data_summary(result.recorded, result.study.traces.hold_out)
    provenance(page.section("Provenance"), data, unit_documents(result.recorded))
    return page


def fit_table(result: SubspaceCalibration) -> tuple[list[str], list[list[Cell]]]:
    """Headers and rows: each model's order and its median FIT of each output, on fitted and on unseen traces."""
    outputs = result.study.outputs
    headers = ["model", "order", *(f"{name}, fitted" for name in outputs), *(f"{name}, unseen" for name in outputs)]
    rows = [
        [name, model.model.order, *medians(model.train), *(medians(model.unseen) or [None] * len(outputs))]
        for name, model in result.candidates.items()
    ]
    return headers, rows


def _free_runs(section: Section, result: SubspaceCalibration) -> None:
    kept = [name for name, trace in result.pieces.items() if trace in result.study.traces.hold_out]
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
    entries = uncertain_modes(result.taken)
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
    """Of the first weighting's models of all orders, as free as they come: only their A and C are looked at."""
    space = result.subspaces[result.study.weightings[0]].space
    free = replace(space, settings=replace(space.settings, poles="free", initial_states=True))
    orders = range(2, borne(space.values, min(SCANNED, space.limit)) + 1)
    sightings = stabilisation([realise(free, order).model for order in orders])
    nyquist = 0.5 / space.pieces.records[0].step
    groups = {
        "stable": [s for s in sightings if s.stable],
        "in frequency": [s for s in sightings if s.in_frequency and not s.stable],
        "new": [s for s in sightings if not s.in_frequency],
    }
    points = {
        name: ([s.mode.frequency for s in group], [float(s.order) for s in group]) for name, group in groups.items()
    }
    return figures.points(points, "frequency [Hz]", "order", limit=nyquist)


def _extraction(section: Section, result: SubspaceCalibration) -> None:
    spaces = {name: found.space for name, found in result.subspaces.items()}
    curves = {
        name: (list(range(1, len(space.values) + 1)), (space.values / space.values[0]).tolist())
        for name, space in spaces.items()
    }
    section.figure(figures.points(curves, "number", "singular value, relative", logarithmic=True))
    rows: list[list[Cell]] = [
        [name, space.condition, space.compression, space.excitation] for name, space in spaces.items()
    ]
    section.table(["weighting", "condition of the data", "compressed by", "condition of the input"], rows)
