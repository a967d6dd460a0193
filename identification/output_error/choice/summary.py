"""A choice among candidates as `summary.json`, the terminal and the report show it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NotRequired

from typing_extensions import TypedDict

from identification.output_error.choice.choice import Choice, FittedCandidate
from identification.output_error.choice.ranking import LEVEL, TELLING, Ranked
from identification.results import finite
from orchestrator.display.table import Cell

FAILED = "failed"


@dataclass(frozen=True)
class CandidateValueSummary:
    """A candidate's estimate; `std` is nan where there is none."""

    value: float
    std: float
    unit: str


class PredictionSummary(TypedDict):
    """How well a candidate predicts the windows held out.

    Attributes:
        error: mean square over that of what was recorded.
        worse: by how much that is more than the chosen one's.
        scatter: within which such a difference tells nothing; null where that is not known.
    """

    error: float
    worse: float
    scatter: float | None


class CandidateSummary(TypedDict):
    """One candidate; of one that failed there is only why.

    Attributes:
        state: chosen, alike (not distinguishable from that one), apart, or failed.
        remark: why it failed or has not converged.
        unknowns: parameters and start values that were fitted.
        aicc, bic: over the least one of all.
        fitted, unseen: median FIT; null where nothing moves or was held out.
    """

    state: str
    remark: str
    unknowns: NotRequired[int]
    aicc: NotRequired[float | None]
    bic: NotRequired[float]
    fitted: NotRequired[float | None]
    unseen: NotRequired[float | None]
    prediction: NotRequired[PredictionSummary | None]
    parameters: NotRequired[dict[str, CandidateValueSummary]]


class ChoiceSummary(TypedDict):
    """Which candidate was chosen, and how.

    Attributes:
        signals: of the recordings, by which they are compared.
        samples: independent ones that criteria count with.
        windows: held out.
        telling: difference of BIC from which on it tells.
        level: of Student's t, from which on a prediction is worse.
        candidates: in their order.
    """

    chosen: str
    signals: list[str]
    samples: float
    windows: int
    telling: float
    level: float
    candidates: dict[str, CandidateSummary]


def summary(choice: Choice) -> ChoiceSummary:
    """The choice in plain values."""
    ranking, rows = choice.ranking, choice.ranking.rows
    least = [min(getattr(row.criteria, key) for row in rows.values()) for key in ("aicc", "bic")]
    found = {name: _candidate(choice, name, row, least) for name, row in rows.items()}
    failed: dict[str, CandidateSummary] = {
        name: {"state": FAILED, "remark": why} for name, why in choice.failed.items()
    }
    return {
        "chosen": choice.chosen,
        "signals": list(choice.signals),
        "samples": rows[choice.chosen].criteria.samples,
        "windows": ranking.windows,
        "telling": TELLING,
        "level": LEVEL,
        "candidates": {**found, **failed},
    }


def _candidate(choice: Choice, name: str, row: Ranked, least: Sequence[float]) -> CandidateSummary:
    outcome = choice.outcomes[name]
    state = "chosen" if name == choice.chosen else "alike" if name in choice.ranking.alike else "apart"
    prediction: PredictionSummary | None = None
    if row.unseen is not None and row.worse is not None and row.scatter is not None:
        prediction = {"error": row.unseen, "worse": row.worse, "scatter": finite(row.scatter)}
    return {
        "state": state,
        "remark": outcome.unsettled,
        "unknowns": outcome.unknowns,
        "aicc": finite(row.criteria.aicc - least[0]),
        "bic": row.criteria.bic - least[1],
        "fitted": finite(outcome.fitted),
        "unseen": None if outcome.unseen is None else finite(outcome.unseen),
        "prediction": prediction,
        "parameters": {known: _value(outcome, known) for known in outcome.values},
    }


def _value(outcome: FittedCandidate, name: str) -> CandidateValueSummary:
    std, unit = outcome.std.get(name, math.nan), outcome.units.get(name, "1")
    return CandidateValueSummary(outcome.values[name], std, unit)


def candidate_rows(choice: ChoiceSummary) -> tuple[list[str], list[list[Cell]]]:
    """Headers and rows of the table of candidates, in their order."""
    best = choice["candidates"][choice["chosen"]].get("prediction")
    size = best["error"] if best else 0.0
    headers = ["candidate", "unknowns", "AICc +", "BIC +", "FIT, fitted", "FIT, unseen", "error², unseen", ""]
    return headers, [_row(name, one, size) for name, one in choice["candidates"].items()]


def _row(name: str, one: CandidateSummary, size: float) -> list[Cell]:
    """A candidate's row; `size` is the chosen one's square of the prediction error."""
    said = {"alike": "not distinguishable", "apart": ""}.get(one["state"], one["state"])
    remark = ": ".join(part for part in (said, one["remark"]) if part)
    if one["state"] == FAILED:
        return [name, None, None, None, None, None, None, remark]
    figures = [_figure(one.get("aicc"), ".1f"), _figure(one.get("bic"), ".1f")]
    fits = [_figure(one.get("fitted"), ".4f"), _figure(one.get("unseen"), ".4f")]
    return [name, str(one["unknowns"]), *figures, *fits, _prediction(one.get("prediction"), size), remark]


def _figure(value: float | None, how: str) -> Cell:
    return None if value is None else format(value, how)


def _prediction(one: PredictionSummary | None, size: float) -> Cell:
    """By how much its square is above the chosen one's, and the scatter of that, in percent."""
    if one is None or not size > 0:
        return None
    scatter = "?" if one["scatter"] is None else _percent(one["scatter"] / size)
    worse = f"{'+' if one['worse'] >= 0 else ''}{_percent(one['worse'] / size)}"
    return f"{worse} ± {scatter} %" if one["worse"] or one["scatter"] else "-"


def _percent(share: float) -> str:
    return f"{100 * share:.0f}" if abs(share) >= 0.1 else f"{100 * share:.2g}"
