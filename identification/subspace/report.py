"""The report of a subspace study: how its models run free, their modes, and where these stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.mode_tracking import stabilisation
from identification.linear.model import LinearModel
from identification.linear.modes import modes, ranked
from identification.linear.reduction import one_by_one
from identification.result_sections import provenance, verdict_callout
from identification.subspace.calibration import SubspaceCalibration
from identification.subspace.orders import borne
from identification.subspace.range_space import RangeSpace
from identification.subspace.realisation import realise
from identification.subspace.summary import model_rows, summary, uncertain_modes
from identification.subspace.trials import ModelCandidate
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures

SHOWN = 4  # traces with their free runs
SCANNED = 30  # highest order of the stabilisation diagram


def report(result: SubspaceCalibration) -> Report:
    """FIT by model, free runs, modes and where they stay, singular values, provenance."""
    page = Report(result.study.title, result.study.description)
    section, found = page.section("Result"), summary(result)
    verdict_callout(section, found["verdict"])
    section.warnings(found["warnings"])
    section.table(*model_rows(found), caption="Median FIT over the traces, free runs")
    section.table(*_tried(result), caption="All that was tried: mean FIT of the traces that models are compared on")
    if result.reduction is not None:
        section.paragraph(f"Reduced: {result.reduction}, before `update` (under all inputs in a row, from rest).")
    _free_runs(page.section("Free runs"), result)
    _modes(page.section("Modes"), result)
    _extraction(page.section("Singular values"), result)
    provenance(page, found)
    return page


def _tried(result: SubspaceCalibration) -> tuple[list[str], list[list[Cell]]]:
    headers = ["weighting", "block", "poles", "D", "order", "mean FIT", ""]
    rows: list[list[Cell]] = []
    for trial in result.trials:
        model, settings = trial.candidate, trial.settings
        order, score = (None, None) if model is None else (model.model.order, model.score)
        direct, why = "yes" if settings.feedthrough else "no", str(trial.error or "")
        rows.append([settings.weighting, settings.block, settings.poles, direct, order, score, why])
    return headers, rows


def _free_runs(section: Section, result: SubspaceCalibration) -> None:
    kept = [name for name, trace in result.pieces.items() if trace in result.study.traces.held_out]
    shown = (kept or list(result.records))[:SHOWN]
    section.paragraph("Traces kept out of the fit." if kept else "Traces of the fit; none was kept out of it.")
    for name in shown:
        record = result.records[name]
        curves = [(candidate.name, record.free_run(candidate.runs[name])) for candidate in _drawn(result)]
        section.figure(figures.overlay(record.free_run(record.y), curves), name)


def _drawn(result: SubspaceCalibration) -> list[ModelCandidate]:
    """The model that is written, and the best of the weightings'."""
    first = result.best.candidate or result.taken
    return [result.taken] if result.taken is first else [first, result.taken]


def _modes(section: Section, result: SubspaceCalibration) -> None:
    """The modes of the model that is written: how sure, how strong, and what leaving one out does."""
    model, u = result.taken.model, np.concatenate([record.u for record in result.records.values()])
    try:
        found, alone = modes(model), one_by_one(model, u)
    except IdentificationError as error:
        section.callout("warning", f"The model that is written has no table of modes: {error}")
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            magnitudes = ranked([mode.response_magnitude(u) for mode in found])
            values = ranked([mode.mode_singular_value(len(u)) for mode in found])
        rows: list[list[Cell]] = [
            [
                entry["mode"],
                *(entry["frequency"], _half(entry["frequency_std"])),
                *(entry["damping"], _half(entry["damping_std"])),
                *(by_mrm, by_msv),
                *(100 * dropped.bound, 100 * dropped.measured),
            ]
            for entry, by_mrm, by_msv, dropped in zip(
                uncertain_modes(result.taken), magnitudes, values, alone, strict=True
            )
        ]
        headers = ["mode", "frequency [Hz]", "± 95 %", "damping", "± 95 %", "MRM rank", "MSV rank"]
        headers += ["dropped: error at most [%]", "measured [%]"]
        section.table(headers, rows, caption=f"Modes of the model that is written ({result.taken.name})")
        section.paragraph(
            "Errors are mean absolute ones of any output, over the greatest mean magnitude of an output, under the "
            "inputs of all records in a row and from rest; for several modes the bounds add up."
        )
    _stabilisation(section, result)


def _half(std: float | None) -> float | None:
    return None if std is None else 1.96 * std


def _stabilisation(section: Section, result: SubspaceCalibration) -> None:
    """Of the best trial's range space, models of all orders as free as they come: only A and C are looked at."""
    best = result.best.result
    assert best is not None
    space = replace(best.space, settings=replace(best.space.settings, poles="free", initial_states=True))
    found, failed = list[LinearModel](), list[str]()
    for order in range(2, borne(space.values, min(SCANNED, space.limit)) + 1):
        try:
            found.append(_with_modes(space, order))
        except IdentificationError:
            failed.append(str(order))
    sightings = stabilisation(found)
    groups = {
        "stable": [s for s in sightings if s.stable],
        "in frequency": [s for s in sightings if s.in_frequency and not s.stable],
        "new": [s for s in sightings if not s.in_frequency],
    }
    points = {
        name: ([s.mode.frequency for s in group], [float(s.order) for s in group]) for name, group in groups.items()
    }
    figure = figures.points(points, "frequency [Hz]", "order", limit=0.5 / space.pieces.records[0].step)
    without = f"; orders {', '.join(failed)} overflow and are not shown" if failed else ""
    section.figure(figure, f"Stabilisation diagram: a mode of the system stays from order to order{without}")


def _with_modes(space: RangeSpace, order: int) -> LinearModel:
    """A model that has modal coordinates.

    Raises:
        IdentificationError: it has none, or overflows.
    """
    model = realise(space, order).model
    modes(model)
    return model


def _extraction(section: Section, result: SubspaceCalibration) -> None:
    spaces = {
        f"{trial.settings.weighting}, block {trial.settings.block}": trial.result.space
        for trial in result.trials
        if trial.result is not None
    }
    curves = {
        name: (list(range(1, len(space.values) + 1)), (space.values / space.values[0]).tolist())
        for name, space in spaces.items()
    }
    section.figure(figures.points(curves, "number", "singular value, relative", logarithmic=True))
    rows: list[list[Cell]] = [
        [name, space.condition, space.compression, space.excitation] for name, space in spaces.items()
    ]
    section.table(["weighting", "condition of the data", "compressed by", "condition of the input"], rows)
