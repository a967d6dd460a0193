"""The linear axis' studies on the recording of the real one: free runs beside published parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.calibrate import calibrate

STUDIES = Path(__file__).parents[3] / "scenarios" / "emps"
PUBLISHED = "published, friction by direction"


@pytest.mark.slow
@pytest.mark.parametrize(("study", "least"), [("calibration.yaml", 0.97), ("windows.yaml", 0.985)])
def test_free_runs_follow_the_real_axis_closer_than_the_published_parameters(
    emps_data: Path, study: str, least: float
) -> None:
    summary = calibrate(STUDIES / study, emps_data).summary
    found, published = summary["fit"]["train"]["median"], summary["fit"]["compared"][PUBLISHED]["median"]
    assert found is not None and published is not None
    assert found > least
    assert found > published > 0.93
    assert summary["verdict"]["converged"]  # type: ignore[typeddict-item]


@pytest.mark.slow
def test_the_short_runs_give_about_the_published_mass_and_friction(emps_data: Path) -> None:
    """Within a tenth of what sliding at 0.1 m/s needs in either direction; the mass within 5 %."""
    values = {name: one["value"] for name, one in calibrate(STUDIES / "windows.yaml", emps_data).parameters.items()}
    assert values["axis.mass"] == pytest.approx(95.1, rel=0.05)
    for side, published in (("positive", 0.1 * 166.7 + 20.1), ("negative", 0.1 * 240.4 + 20.6)):
        needed = 0.1 * values[f"axis.viscous_friction_{side}"] + values[f"axis.coulomb_friction_{side}"]
        assert needed == pytest.approx(published, rel=0.1)
