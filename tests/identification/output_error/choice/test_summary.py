"""The table of candidates says what a summary holds."""

from __future__ import annotations

from identification.output_error.choice.summary import (
    FAILED,
    CandidateSummary,
    ChoiceSummary,
    PredictionSummary,
    candidate_rows,
)


def one(state: str, bic: float, prediction: PredictionSummary | None) -> CandidateSummary:
    return {
        "state": state,
        "remark": "",
        "unknowns": 3,
        "aicc": None,
        "bic": bic,
        "fitted": 0.98765,
        "unseen": None,
        "prediction": prediction,
    }


def test_squared_errors_are_told_over_the_one_of_the_chosen_with_their_scatter() -> None:
    candidates: dict[str, CandidateSummary] = {
        "best": one("chosen", 0.0, {"error": 0.5, "worse": 0.0, "scatter": 0.0}),
        "worse": one("apart", 12.34, {"error": 0.75, "worse": 0.25, "scatter": 0.01}),
        "as good": one("alike", 1.0, {"error": 0.49, "worse": -0.01, "scatter": None}),
        "broken": {"state": FAILED, "remark": "diverges"},
    }
    choice = ChoiceSummary(
        chosen="best", signals=["y"], samples=9.0, windows=4, telling=6.0, level=0.05, candidates=candidates
    )
    headers, rows = candidate_rows(choice)
    assert all(len(row) == len(headers) for row in rows)
    assert rows == [
        ["best", "3", None, "0.0", "0.9877", None, "-", "chosen"],
        ["worse", "3", None, "12.3", "0.9877", None, "+50 ± 2 %", ""],
        ["as good", "3", None, "1.0", "0.9877", None, "-2 ± ? %", "not distinguishable"],
        ["broken", None, None, None, None, None, None, "failed: diverges"],
    ]
    candidates["best"]["prediction"] = None
    assert [row[6] for row in candidate_rows(choice)[1]] == [None] * 4
