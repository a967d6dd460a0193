"""Coverage of the 95 % intervals of the resonance study, on fewer draws than the benchmarks take."""

from __future__ import annotations

import pytest

from tests.benchmarks.figure import share_inside
from tests.benchmarks.identification import coverage_frequency

LEAST = 0.85  # exact intervals cover less often in one of 300 sets of 40 draws


@pytest.mark.slow
def test_resonance_study_intervals_cover_the_parameters_of_the_synthetic_campaign() -> None:
    block, experiments = coverage_frequency.campaign()
    draws = coverage_frequency.intervals(block, experiments, 40)
    shares = {
        name: share_inside([draw[name] for draw in draws], true)
        for name, true in coverage_frequency.truth(block).items()
    }
    assert set(shares) == {"p1", "p2", "p3", "p4"}
    assert min(shares.values()) >= LEAST, shares
    assert sum(shares.values()) < 4, "intervals that always cover are too wide"
