"""What a study leaves open is compared; what fails is an entry; the model with the best free run is written."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmus.packaging.native import compiler
from identification.calibrate import CalibratedStudy, calibrate
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData
from identification.subspace.free_runs import free_runs, horizon
from identification.subspace.trials import Sides
from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white

PLANT = model_of([eigenvalue(9.0, 0.03), eigenvalue(23.0, 0.05), 0.98], outputs=1)
U_ZERO, Y_ZERO = 3.0, -20.0
SHORTEST = (
    "title: shortest\nmethod: subspace\ntraces: {files: '*.csv', hold_out: [second]}\ninputs: [u]\noutputs: [y]\n"
)


def recorded(folder: Path, plant: LinearModel = PLANT, noise: float = 0.0) -> Path:
    """Two recordings about an operating point, each from a state of its own, and the shortest study beside them."""
    for number, name in enumerate(("first", "second")):
        u, rng = white(700, seed=number), np.random.default_rng([5, number])
        y = plant.simulate(u, rng.normal(size=plant.order))[:, 0]
        y = y + noise * np.std(y) * rng.normal(size=len(y))
        signals = {"u": u[:, 0] + U_ZERO, "y": y + Y_ZERO}
        formats.write(Trace(STEP * np.arange(len(u)), signals, {"u": "V", "y": "rad"}, name), folder / f"{name}.csv")
    file = folder / "study.yaml"
    file.write_text(SHORTEST)
    return file


def found(file: Path, more: str = "") -> CalibratedStudy:
    file.write_text(SHORTEST + more)
    return calibrate(file, file.parent)


def test_the_shortest_study_finds_the_plant_about_its_operating_point(tmp_path: Path) -> None:
    summary = found(recorded(tmp_path)).summary
    assert summary["fit"]["validation"]["median"] > 0.99  # type: ignore[index]
    assert {(one["poles"], one["feedthrough"]) for one in summary["tried"]} >= {("free", True), ("stable", False)}  # type: ignore[typeddict-item]


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="needs a C compiler")
def test_the_offset_travels_in_the_fmu(tmp_path: Path) -> None:
    """Once the start has died away (0.98 a sample): it rests at the mean input, where the plant does not."""
    found(recorded(tmp_path)).write(tmp_path / "out")
    u = white(1000, seed=9)[:, 0]
    time = STEP * np.arange(len(u))
    driven = np.array(list(zip(time, u + U_ZERO, strict=True)), dtype=[("time", float), ("u", float)])
    fmu = str(tmp_path / "out" / "fmus" / "plant.fmu")
    y = fmpy.simulate_fmu(fmu, input=driven, stop_time=time[-1], output_interval=STEP, output=["y"])["y"]
    expected = PLANT.simulate(u[:, None])[:, 0] + Y_ZERO
    errors = [np.abs(y[600 + late :] - expected[600 : len(y) - late]).max() for late in (0, 1)]
    assert min(errors) < 1e-4 * np.abs(expected - Y_ZERO).max()


def test_the_model_with_the_best_free_run_is_written_whatever_comes_first(tmp_path: Path) -> None:
    result = found(recorded(tmp_path, noise=0.1), "weightings: [orse, cva]\nblock: 20\nrefine: true\n").result
    assert result.taken.score == max(candidate.score for candidate in result.candidates.values())
    assert result.candidates["refined"].score > 0.8


def test_a_way_that_fails_is_an_entry_and_not_the_end(tmp_path: Path) -> None:
    """Five block rows bear four states of one output at most; larger ones bear the five that are asked for."""
    summary = found(recorded(tmp_path), "order: 5\n").summary
    failed = [one for one in summary["tried"] if one["problem"]]  # type: ignore[typeddict-item]
    assert {one["block"] for one in failed} == {5}
    assert all(one["order"] is None and one["fit"] is None for one in failed)
    assert summary["fit"]["validation"]["median"] > 0.99  # type: ignore[index]


def test_a_run_that_overflows_has_the_lowest_score_and_ends_nothing() -> None:
    wild = model_of([3.0 + 0j], outputs=1)
    record = InputOutputData(white(2000, seed=1), white(2000, seed=2), STEP, wild.inputs, wild.outputs)
    _, fits = free_runs(wild, [record], 3)
    judged = Sides((record,), (record,), start=3 * STEP).judged("wild", "", wild)
    assert not np.isfinite(fits).any() or fits.max() < -1
    assert judged.score == -1.0


@pytest.mark.parametrize(
    ("frequency", "damping", "periods"), [(9.0, 0.03, 3.0), (2.0, 0.0, 3.0), (0.5, 0.3, 3 * 1 / (2 * np.pi * 0.3))]
)
def test_a_state_is_told_from_some_periods_or_time_constants_of_the_slowest_mode(
    frequency: float, damping: float, periods: float
) -> None:
    model = model_of([eigenvalue(frequency, damping), eigenvalue(40.0, 0.1)], outputs=1)
    assert horizon(model) == pytest.approx(periods / frequency / STEP, rel=0.1)
    assert horizon(model_of([1.0 + 0j, 0.5 + 0j], outputs=1)) == np.inf
