"""Few figures of many FITs: the worst is never hidden by a median, and has its place."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from identification.fits import fit_summary, told
from identification.results import verdict

NAMES = ("angle", "speed")
FITS = arrays(float, (4, 2), elements=st.floats(-5, 1) | st.just(float("nan")))


@given(FITS)
def test_the_worst_is_the_lowest_of_all_and_named_by_window_trace_and_output(fit: np.ndarray) -> None:
    found = fit_summary(fit, ["a 0", "a 1", "b 0", "b 1"], ["a", "a", "b", "b"], NAMES)
    worst = found["worst"]
    if np.isnan(fit).all():
        assert worst is None and found["median"] is None
        return
    assert worst is not None and worst["fit"] == np.nanmin(fit)
    row = ["a 0", "a 1", "b 0", "b 1"].index(worst["window"])
    assert fit[row, NAMES.index(worst["output"])] == worst["fit"] and worst["window"].startswith(worst["trace"])
    assert set(found["matrix"]) == {"a", "b"} and found["median"] == float(np.median(fit[~np.isnan(fit)]))


def test_a_run_that_overflows_is_the_worst_and_has_no_figure() -> None:
    found = fit_summary(np.array([[0.9, -np.inf], [0.8, 0.7]]), ["a", "b"], ["a", "b"], NAMES)
    assert told(found["worst"]) == "overflows (speed of a)"


def test_a_target_for_the_worst_is_missed_where_the_median_is_reached() -> None:
    found = fit_summary(np.array([[0.9, 0.95], [0.2, 0.97]]), ["a", "b"], ["a", "b"], NAMES)
    judged = verdict(found, "unseen", 0.9, worst_at_least=0.5)
    assert not judged["held"] and "MISSED: worst FIT, unseen, 0.2000 (angle of b), at least 0.5" in judged["said"]
    assert verdict(found, "unseen", 0.9, worst_at_least=0.1)["held"]
