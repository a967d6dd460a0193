"""The real flexible link: what its grey box and its linear models predict of recordings they were not fitted to."""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.commands import calibrate_study

STUDIES = Path(__file__).parents[2] / "scenarios" / "flexible_link"


def outputs(study: str, data: Path, folder: Path) -> dict[str, float]:
    """Output -> median FIT of free runs over whole recordings kept out of the fit."""
    document = calibrate_study(STUDIES / study, data, folder, lambda fraction, remark: None)
    return document["fit"]["validation"]["outputs"]  # type: ignore[no-any-return]


@pytest.mark.slow
def test_grey_box_predicts_unseen_recordings_of_the_real_link(flexible_link_data: Path, tmp_path: Path) -> None:
    found = outputs("calibration.yaml", flexible_link_data, tmp_path / "out")
    assert found["link.accelerometer"] > 0.76
    assert found["link.encoder"] > 0.8


@pytest.mark.slow
def test_linear_model_predicts_unseen_recordings_of_the_real_link(flexible_link_data: Path, tmp_path: Path) -> None:
    found = outputs("subspace.yaml", flexible_link_data, tmp_path / "out")
    assert found["a"] > 0.7
    assert found["theta"] > 0.55
