"""An FMU says whose its parts are, wherever it goes."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from fmus import build
from fmus.packaging import licenses

ROOT = Path(__file__).parents[3]
TERMS = (ROOT / "LICENSE").read_text()


def test_the_terms_that_travel_are_those_of_the_project() -> None:
    assert (ROOT / "fmus" / "packaging" / "license.txt").read_text() == TERMS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "fmi", "others"),
    [("native", 2, "headers of FMI"), ("native", 3, "headers of FMI"), ("python", 2, "MIT License")],
)
def test_an_fmu_holds_the_terms_of_all_that_it_carries(tmp_path: Path, target: str, fmi: int, others: str) -> None:
    with zipfile.ZipFile(build("pendulum", tmp_path / "pendulum.fmu", target=target, fmi=fmi)) as archive:
        text = archive.read(licenses.NAME).decode()
    assert TERMS in text and others in text
