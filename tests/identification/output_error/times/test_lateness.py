"""Outputs that are recorded late or early, and nobody says so: the residuals do, and by how much."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from identification.estimation.arrow_least_squares import Loss
from identification.estimation.parameters import InitialState, Parameter, ParameterSet
from identification.estimation.prior import Normal
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import SearchOptions
from identification.output_error.search.problem import Problem, Window
from orchestrator import formats
from orchestrator.trace import FloatArray, Trace
from tests.support.identification import small_study

STEP, NOISE = 0.01, 0.02
TIME = np.arange(201) * STEP
WINDOWS, LATE = 4, 0.4  # samples
TRUTH = {"m.size": 1.0, "m.rate": 6.0}


@dataclass(frozen=True)
class Swings:
    """Two outputs of swings from a start value each, in closed form; recorded so many samples late."""

    late: tuple[float, float] = (0.0, 0.0)

    def __call__(self) -> Swings:
        return self

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        size, rate, lag = values["m.size"], values["m.rate"], values.get("lag", 0.0)
        time = [TIME - STEP * (late + lag) for late in self.late]
        first = size * np.sin(rate * time[0] + window) + values["m.start"]
        return np.column_stack((first, size * np.cos(rate * time[1] + window)))

    def close(self) -> None:
        return None


def fitted(
    late: tuple[float, float], seed: int = 0, loss: Loss | None = None, free: ParameterSet | None = None
) -> Estimate:
    starts, rng = InitialState("m.start", (0.1,) * WINDOWS, estimated=True), np.random.default_rng([5, seed])
    clean = [Swings(late).simulate(w, {**TRUTH, "m.start": 0.3 * w}) for w in range(WINDOWS)]
    windows = [
        Window(str(w), "t", one + NOISE * rng.standard_normal(one.shape), np.full(2, 1 / NOISE))
        for w, one in enumerate(clean)
    ]
    free = free or ParameterSet((Parameter("m.size", 1.05), Parameter("m.rate", 6.02)))
    problem = Problem(free, tuple(windows), ("first", "second"), (starts,), loss or Loss())
    return estimate(problem, Swings(), SearchOptions())


@pytest.mark.parametrize(
    ("late", "outputs"),
    [((LATE, LATE), ("first", "second")), ((-LATE, -LATE), ("first", "second")), ((0.0, LATE), ("second",))],
)
@pytest.mark.parametrize("loss", [Loss(), Loss("huber", 3.0)])
def test_a_delay_that_nobody_tells_is_found_with_its_uncertainty(
    late: tuple[float, float], outputs: tuple[str, ...], loss: Loss
) -> None:
    found = fitted(late, loss=loss).late
    assert found is not None and found.outputs == outputs
    assert abs(found.steps - late[1]) < 4 * found.std < abs(late[1])
    assert max(map(abs, found.moved.values())) > 1 and 0 < found.explained < 1


def test_what_is_on_time_is_never_called_late() -> None:
    assert [seed for seed in range(25) if fitted((0.0, 0.0), seed).late is not None] == []


def test_a_delay_that_is_a_parameter_is_told_no_more() -> None:
    free = ParameterSet((Parameter("m.size", 1.05), Parameter("m.rate", 6.02), Parameter("lag", 0.0, -1.0, 1.0)))
    found = fitted((LATE, LATE), free=free)
    assert found.late is None and found.ci95["lag"][0] < LATE < found.ci95["lag"][1]


def test_its_deviation_is_how_it_scatters() -> None:
    found = [fitted((LATE, LATE), seed).late for seed in range(40)]
    sizes = np.array([one.steps for one in found if one is not None])
    stds = np.array([one.std for one in found if one is not None])
    assert len(sizes) == 40 and 0.7 < sizes.std(ddof=1) / stds.mean() < 1.4


def test_what_is_known_before_takes_part_in_it() -> None:
    """A rate that is known cannot make up for a delay, nor go with it: then no estimate moves."""
    for deviation, told in ((1e-5, False), (5e-4, True)):
        known = Parameter("m.rate", 6.0, prior=Normal(6.0, deviation))
        late = fitted((LATE, LATE), free=ParameterSet((Parameter("m.size", 1.05), known))).late
        assert (late is not None) is told
        assert late is None or (
            late.std < 0.9 * fitted((LATE, LATE)).late.std and abs(late.steps - LATE) < 4 * late.std
        )


@pytest.mark.slow
@pytest.mark.parametrize(("late", "which"), [(0.004, "later"), (-0.004, "earlier")])
def test_a_study_says_by_how_much_a_recording_is_late_or_early(late: float, which: str, tmp_path: Path) -> None:
    data = small_study.record(tmp_path / "data", noise=1e-5)
    for file in data.iterdir():
        trace = formats.read(file).trace
        angle = np.interp(trace.time - late, trace.time, trace["angle"])
        shifted = Trace(trace.time, {"voltage": trace["voltage"], "angle": angle}, {"voltage": "V", "angle": "rad"})
        formats.write(shifted, file)
    study = small_study.write_study(tmp_path / "study.yaml", truth=None)
    warnings = " ".join(small_study.calibrated(study, data, tmp_path / "out")["warnings"])
    said = re.search(rf"outputs\.hand\.angle: residuals look as if recorded ([\d.e-]+) s {which} than", warnings)
    assert said is not None, warnings
    assert float(said[1]) == pytest.approx(abs(late), rel=0.05)
