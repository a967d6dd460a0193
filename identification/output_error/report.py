"""The report of a calibration: how well it fits, what was found, what is left over, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.validation import whiteness
from identification.fits import told
from identification.output_error.calibration import Calibration, Judged
from identification.output_error.choice.report import draw_candidates
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.results import (
    OutputErrorSummary,
    WindowsSummary,
    shooting_words,
    summary,
    windows_words,
)
from identification.output_error.uncertainty_report import uncertainty
from identification.result_sections import draw_parameters, provenance, verdict_callout
from identification.signals.frequency_response import fit_sine
from identification.signals.processing import dominant_frequency
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures
from orchestrator.trace import FloatArray

SHOWN = 12  # windows in the grid of overlays


def report(calibration: Calibration) -> Report:
    """The whole report."""
    result, found = Report(calibration.study.title, calibration.study.description), summary(calibration)
    _overview(result.section("Result"), calibration, found)
    if calibration.choice is not None:
        draw_candidates(result.section("Candidates"), calibration.choice)
    shown = calibration.validation or calibration.train
    overlays(result.section("Free runs"), calibration.units, shown, calibration.compared)
    if calibration.study.run.inputs:
        _frequency_response(result.section("Frequency response"), calibration, shown)
    _residuals(result.section("Residuals"), calibration, shown)
    uncertainty(result.section("Uncertainty"), calibration)
    if "windows" in found:
        _windows(result.section("Windows"), found["windows"])
    if (shot := found["search"].get("shooting")) is not None:
        result.section("Segments").paragraph(f"{shooting_words(shot)[0].upper()}{shooting_words(shot)[1:]}.")
    provenance(result, found)
    return result


def _windows(section: Section, windows: WindowsSummary) -> None:
    """How the recordings have chosen windows."""
    section.paragraph(f"{windows_words(windows)[0].upper()}{windows_words(windows)[1:]}.")
    rows: list[list[Cell]] = [
        [name, str(one.taken), str(one.still), str(one.less)] for name, one in windows["traces"].items()
    ]
    section.table(["trace", "taken", "still", "less motion than those"], rows, numeric=(1, 2, 3))


def _overview(section: Section, calibration: Calibration, found: OutputErrorSummary) -> None:
    target = calibration.study.at_least
    validation = calibration.validation
    highlights: list[tuple[str, str, str]] = []
    if validation is not None:
        worst = told(validation.summary.get("worst"))
        remark = f"{len(validation.windows)} windows of traces not used in the fit, worst {worst}"
        highlights.append(("median FIT, unseen", f"{validation.median:.3f}", remark))
    train = calibration.train
    remark = f"{len(train.windows)} windows, worst {told(train.summary.get('worst'))}"
    highlights.append(("median FIT, fitted", f"{train.median:.3f}", remark))
    for name, judged in calibration.compared.items():
        remark = f"the same windows as the first figure, worst {told(judged.summary.get('worst'))}"
        highlights.append((f"median FIT, {name}", f"{judged.median:.3f}", remark))
    section.highlights(highlights)
    verdict_callout(section, found["verdict"])
    section.warnings(calibration.warnings)
    draw_parameters(section, found["parameters"], "Estimates with half of their 95 % intervals")
    groups = {"fitted": calibration.train} | ({} if validation is None else {"unseen": validation})
    fits(section, groups, target)


def fits(section: Section, groups: Mapping[str, Judged], target: float | None) -> None:
    """FIT by trace as bars; with several outputs also by output, as a table."""
    found = {name: judged.summary for name, judged in groups.items()}
    bars = {
        name: {trace: np.nan if fit is None else fit for trace, fit in one["traces"].items()}
        for name, one in found.items()
    }
    section.figure(figures.bars(bars, target, "median FIT of the trace's windows"), "FIT by trace")
    outputs = next(iter(groups.values())).outputs
    if len(outputs) > 1:
        rows = [
            [trace, name, *map(_figure, own.values())]
            for name, one in found.items()
            for trace, own in one["matrix"].items()
        ]
        rows += [["median", name, *map(_figure, one["outputs"].values())] for name, one in found.items()]
        rows += [
            ["worst", name, *(f"{fit:.3f}" for fit in np.nanmin(judged.fit, axis=0))] for name, judged in groups.items()
        ]
        section.table(["trace", "", *outputs], rows, caption="Median FIT of the trace's windows, by output")


def _figure(fit: float | None) -> str | None:
    return None if fit is None else f"{fit:.3f}"


def overlays(section: Section, units: Mapping[str, str], judged: Judged, compared: Mapping[str, Judged]) -> None:
    """The window of median FIT for each output, and small ones from the worst to the best."""
    others = {name: other for name, other in compared.items() if len(other.windows) == len(judged.windows)}
    ranked = np.argsort(np.nan_to_num(judged.fit.mean(axis=1)))
    middle = int(ranked[len(ranked) // 2])
    measured, simulated = judged.traces(middle, units)
    runs = [("calibrated", simulated)]
    runs += [(name, other.traces(middle, units)[1]) for name, other in others.items()]
    section.figure(figures.overlay(measured, runs), f"The window of median FIT, {measured.name}")
    chosen = np.linspace(0, len(ranked) - 1, min(SHOWN, len(ranked))).astype(int)
    grid = []
    for i in (int(ranked[place]) for place in chosen):
        measured, simulated = judged.traces(i, units)
        grid.append((f"{measured.name}, FIT {judged.fit[i].mean():.3f}", measured, [("calibrated", simulated)]))
    section.figure(figures.overlays_grid(grid, judged.outputs[0]), "From the worst window to the best")


def _frequency_response(section: Section, calibration: Calibration, judged: Judged) -> None:
    points = [_gains(window, y) for window, y in zip(judged.windows, judged.simulated, strict=True)]
    found = np.array([point for point in points if point is not None])
    missing = len(points) - len(found)
    section.paragraph(
        "Gain from the first input to the first output at the strongest frequency of each window's input."
        + (f" {missing} of {len(points)} windows hold no full period of a sine and are left out." if missing else "")
    )
    if len(found):
        curves = [("measured", found[:, 0], found[:, 1]), ("calibrated", found[:, 0], found[:, 2])]
        section.figure(figures.frequency_response(curves))


def _gains(window: FreeRunWindow, simulated: FloatArray) -> tuple[float, float, float] | None:
    """Strongest frequency of the first input [rad/s] and the gains of the first output there, measured and simulated;
    None where the window holds no sine."""
    driven = next(iter(window.stimuli.values()))
    try:
        start = dominant_frequency(driven, float(window.step))
        cause = fit_sine(window.run_time, driven, start, refine=True)
        measured, free = (fit_sine(window.time, y[:, 0], cause.frequency) for y in (window.measured, simulated))
    except IdentificationError:
        return None
    if cause.amplitude <= 3 * cause.amplitude_std:
        return None
    return cause.frequency, measured.amplitude / cause.amplitude, free.amplitude / cause.amplitude


def _residuals(section: Section, calibration: Calibration, judged: Judged) -> None:
    errors = [window.measured - y for window, y in zip(judged.windows, judged.simulated, strict=True)]
    tests = [whiteness([error[:, column] for error in errors]) for column in range(len(judged.outputs))]
    for output, test in zip(judged.outputs, tests, strict=True):
        verdict = "are white" if test.white else "are not white: the model leaves something out"
        section.callout(
            "ok" if test.white else "warning", f"Residuals of {output} {verdict} (Ljung-Box p = {test.p_value:.3g})."
        )
    middle = int(np.argsort(np.nan_to_num(judged.fit[:, 0]))[len(judged.windows) // 2])
    first = judged.outputs[0]
    window = judged.windows[middle]
    figure = figures.residuals(
        window.time,
        errors[middle][:, 0],
        tests[0].autocorrelation,
        tests[0].band,
        calibration.units.get(first, ""),
        f"error of {first}",
    )
    section.figure(figure, f"The window of median FIT, {window.name}, and the autocorrelation of all windows")
