"""FIT of many windows or records and outputs in few figures: medians, and beside them the worst with its place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict

from orchestrator.trace import FloatArray


class WorstSummary(TypedDict):
    """The lowest FIT, null for a run that overflows, and where it is."""

    fit: float | None
    trace: str
    window: str
    output: str


class FitSummary(TypedDict):
    """FIT of some windows: the median of all, of each trace and of each output; null where none moves.

    Attributes:
        worst: of a window and output; null where none moves.
        matrix: trace -> output -> median over the trace's windows.
    """

    median: float | None
    traces: dict[str, float | None]
    windows: NotRequired[int]
    outputs: NotRequired[dict[str, float | None]]
    worst: NotRequired[WorstSummary | None]
    matrix: NotRequired[dict[str, dict[str, float | None]]]


def fit_summary(fit: FloatArray, windows: Sequence[str], traces: Sequence[str], outputs: Sequence[str]) -> FitSummary:
    """The figures of FIT (W, m) of these windows, each of a trace, and outputs; nan where an output does not move."""
    rows = {trace: fit[[other == trace for other in traces]] for trace in dict.fromkeys(traces)}
    return {
        "median": median(fit),
        "windows": len(fit),
        "traces": {trace: median(own) for trace, own in rows.items()},
        "outputs": _by_output(fit, outputs),
        "worst": _worst(fit, windows, traces, outputs),
        "matrix": {trace: _by_output(own, outputs) for trace, own in rows.items()},
    }


def median(fit: FloatArray) -> float | None:
    """Over what moves; None where nothing does, or most runs overflow."""
    known = fit[~np.isnan(fit)]
    found = float(np.median(known)) if known.size else float("nan")
    return found if np.isfinite(found) else None


def told(worst: WorstSummary | None) -> str:
    """The worst in words: 0.4212 (angle of step2)."""
    if worst is None:
        return "none"
    figure = "overflows" if worst["fit"] is None else f"{worst['fit']:.4f}"
    return f"{figure} ({worst['output']} of {worst['window']})"


def _by_output(fit: FloatArray, outputs: Sequence[str]) -> dict[str, float | None]:
    return {name: median(column) for name, column in zip(outputs, fit.T, strict=True)}


def _worst(
    fit: FloatArray, windows: Sequence[str], traces: Sequence[str], outputs: Sequence[str]
) -> WorstSummary | None:
    if np.isnan(fit).all():
        return None
    row, column = divmod(int(np.nanargmin(fit)), fit.shape[1])
    lowest = float(fit[row, column])
    found = lowest if np.isfinite(lowest) else None
    return {"fit": found, "trace": traces[row], "window": windows[row], "output": outputs[column]}
