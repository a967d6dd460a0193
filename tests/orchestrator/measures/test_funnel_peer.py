"""Our funnel is that of pyfunnel, bound by bound, where both offer one: absolute tolerances, open to both sides."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from orchestrator.measures import FunnelTolerance, funnel
from orchestrator.trace import FloatArray

pytestmark = pytest.mark.needs("tools")


@pytest.mark.parametrize("seed", range(12))
def test_bounds_and_verdicts_are_those_of_pyfunnel_on_random_signals(seed: int, tmp_path: Path) -> None:
    from pyfunnel import compareAndReport

    rng = np.random.default_rng(seed)
    count, value, time = rng.integers(5, 60), *rng.uniform(0.05, 0.6, 2)
    stamps = np.cumsum(rng.uniform(0.1, 1.0, count))
    reference = np.cumsum(rng.normal(size=count))
    if seed % 3 == 0:
        reference = np.round(reference)  # with stretches that do not move
    judged = np.linspace(stamps[0], stamps[-1], 300)
    signal = np.interp(judged - rng.uniform(0.0, 0.5), stamps, reference)
    lists = [list(map(float, one)) for one in (stamps, reference, judged, signal)]
    assert compareAndReport(*lists, outputDirectory=str(tmp_path), atolx=float(time), atoly=float(value)) == 0
    lower, upper = funnel(judged, stamps, reference, FunnelTolerance(value, leading=time, lagging=time))
    inside = (judged >= stamps[0]) & (judged <= stamps[-1])
    for own, name in ((lower, "lowerBound"), (upper, "upperBound")):
        theirs = _read(tmp_path / f"{name}.csv")
        assert own[inside] == pytest.approx(np.interp(judged[inside], *theirs), abs=1e-9)
    wrong = (signal < lower - 1e-9) | (signal > upper + 1e-9)
    assert int(np.count_nonzero(_read(tmp_path / "errors.csv")[1] > 1e-9)) == int(np.count_nonzero(wrong))


def _read(file: Path) -> FloatArray:
    """(2, K) stamps and values."""
    with file.open(encoding="utf-8", newline="") as opened:
        return np.array([[float(cell) for cell in row] for row in list(csv.reader(opened))[1:]]).T
