"""The report's section on what the estimates are worth: intervals, noise, what is seen of which parameter, and when."""

from __future__ import annotations

import numpy as np

from identification.output_error.calibration import Calibration
from identification.output_error.results import GIVEN
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.profile_curve import CostProfile
from orchestrator.display.table import Cell
from orchestrator.display.titles import with_unit
from orchestrator.report import Chart, ChartLine, Curve, Panel, Section, figures
from orchestrator.report.drawings import ChartGrid
from orchestrator.trace import FloatArray

HOW = {
    "white": "Covariance for white residuals, s² (JᵀJ)⁻¹.",
    "coloured": "Residuals are correlated: covariance with an autoregressive model of them.",
    "none": "Not known: the calibration was stopped before.",
    "window": "Residuals are correlated: covariance from leaving out one window at a time.",
}
BY = {
    "local": "Intervals are from this covariance.",
    "profile": "Intervals are read off profiles: a parameter is held, all others are fitted anew.",
    "bootstrap": "Intervals are by bootstrap: all is fitted anew to windows drawn with replacement.",
}


def uncertainty(section: Section, calibration: Calibration) -> None:
    """How intervals came about, noise, correlations, singular values, and what the search took."""
    found = calibration.estimate
    seen = found.identifiability
    section.paragraph(f"{HOW[found.uncertainty.method]} {BY[found.intervals.by]} {GIVEN[0].upper()}{GIVEN[1:]}.")
    for combination in (*seen.unseen, *seen.weak):
        section.callout("warning", f"{combination.message}. What would show it: {combination.remedy}.")
    _other_intervals(section, found, calibration)
    _known(section, found)
    _noise(section, found, calibration)
    _told(section, found, calibration)
    section.figure(figures.correlation_heatmap(seen.names, seen.correlation), "Correlation of the estimates")
    directions = np.arange(1.0, len(seen.singular_values) + 1)
    strengths = Curve("singular value", directions, np.asarray(seen.singular_values), "dots")
    section.figure(
        Chart([Panel("singular value", [strengths], log=True)], x="direction of the parameters"),
        "Singular values of the scaled Jacobian: a direction far below the others is hardly seen in the data",
    )
    section.table(
        ["direction", "singular value"],
        [[i + 1, float(v)] for i, v in enumerate(seen.singular_values)],
        caption="Singular values of the scaled Jacobian",
    )
    tally = found.tally
    section.paragraph(
        f"{found.message}: {found.iterations} iterations, {tally.simulations} simulations, "
        f"{tally.failures} of them failed."
    )
    if tally.differences:
        section.paragraph(f"Derivatives are differences and not exact: {tally.differences}.")


def _other_intervals(section: Section, found: Estimate, calibration: Calibration) -> None:
    """Profiles drawn, and intervals beside the local ones."""
    if found.intervals.by == "local":
        return
    rows: list[list[Cell]] = []
    for name in found.free:
        ends = [*found.ci95[name], *found.local95[name]]
        rows.append([name, found.values[name], *(end if np.isfinite(end) else "open" for end in ends)])
    headers = ["parameter", "estimate", "from", "to", "locally from", "to"]
    section.table(headers, rows, caption="95 % intervals, and what they would be from the sensitivities alone")
    charts = [
        (name, _drawn(curve, with_unit(name, calibration.units.get(name, "1"))))
        for name, curve in found.intervals.profiles.items()
    ]
    if charts:
        section.figure(
            ChartGrid(charts),
            "Profiles: how the least cost rises beside each estimate; the interval is where it is below the line. "
            "A parabola is what local intervals take it for.",
        )


def _known(section: Section, found: Estimate) -> None:
    """What was known before beside what the recordings made of it."""
    rows: list[list[Cell]] = [
        [name, known.text, found.values[name], found.std[name], f"{100 * known.added:.0f} %", known.source]
        for name, known in found.known.items()
    ]
    if rows:
        headers = ["parameter", "known before", "estimate", "standard deviation", "added by the recordings", "source"]
        section.table(headers, rows, caption="What was known before, and by how much of its variance recordings cut it")


def _noise(section: Section, found: Estimate, calibration: Calibration) -> None:
    """What is taken for noise, of each output."""
    rows: list[list[Cell]] = [
        [
            with_unit(one.output, calibration.units.get(one.output, "1")),
            one.std,
            "white" if one.white else f"not white: {test.why_not}",
            one.samples_each,
            one.resolution or None,
            one.rounding or None,
        ]
        for one, test in zip(found.noise, found.uncertainty.whiteness, strict=True)
    ]
    section.table(
        ["output", "left over, rms", "", "samples that count as one", "recorded in steps of", "which round by, rms"],
        rows,
        caption="What is taken for noise",
    )


def _told(section: Section, found: Estimate, calibration: Calibration) -> None:
    """Which part of the recordings informs which parameter."""
    told, windows = found.told, calibration.train.windows
    if told is None or not found.free:
        return
    time = np.arange(len(told.over_time)) * float(windows[0].step)
    so_far = np.cumsum(told.over_time, axis=0)
    seen = [i for i in range(len(found.free)) if np.isfinite(so_far[-1, i])]
    curves = [Curve(found.free[i], time, so_far[:, i], colour=number) for number, i in enumerate(seen)]
    if not curves:
        return
    section.figure(
        Chart([Panel("share told so far", curves, range=(0.0, 1.0))], x="time in the windows [s]"),
        "Which part of the windows informs which parameter: steep is what tells of it, flat could be left out",
    )
    traces = list(dict.fromkeys(window.trace for window in windows))
    rows: list[list[Cell]] = []
    for trace in traces if len(traces) > 1 else ():
        own = told.by_window[[window.trace == trace for window in windows]].sum(axis=0)
        rows.append([trace, *_percent(own)])
    outputs = calibration.train.outputs
    rows += [[name, *_percent(own)] for name, own in zip(outputs, told.by_output, strict=True) if len(outputs) > 1]
    if rows:
        section.table(["", *found.free], rows, caption="Share of each trace and output in what is known of a parameter")


def _percent(shares: FloatArray) -> list[Cell]:
    return [f"{100 * share:.0f} %" if np.isfinite(share) else None for share in shares]


def _drawn(curve: CostProfile, axis: str) -> Chart:
    """A profile, with what is 95 % likely below the line."""
    line = ChartLine(curve.threshold, "y", "95 %")
    return Chart([Panel("rise", [Curve("profile", curve.values, curve.rise)], [line])], x=axis, legend=False)
