"""The README's page in Python does what it says, as a script and as a notebook."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from identification.results import read_summary
from identification.study import load_study

ROOT = Path(__file__).parents[1]
PAGE = re.search(r"^```python\n(# first_page\.py\n.*?)^```$", (ROOT / "README.md").read_text(), re.M | re.S)[1]  # type: ignore[index]


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the scenarios, where the packages of this tree are imported."""
    shutil.copytree(ROOT / "scenarios", tmp_path / "scenarios")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return tmp_path


@pytest.mark.parametrize("file", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda file: file.stem)
def test_notebooks_of_the_site_are_kept_without_what_came_out(file: Path) -> None:
    cells = nbformat.read(file, as_version=4).cells
    assert not [cell for cell in cells if cell.cell_type == "code" and (cell.outputs or cell.execution_count)]


def check_estimates(folder: Path) -> None:
    """The estimates that were written hold the truth behind the simulated rig within 1 %."""
    truth = load_study(folder / "study.yaml").block.truth
    parameters = read_summary(folder)["parameters"]
    assert {name: parameters[name]["value"] for name in truth} == pytest.approx(truth, rel=0.01)
    assert {file.name for file in (folder / "fmus").iterdir()} == {"motor.fmu", "hand.fmu"}


@pytest.mark.slow
def test_the_page_is_a_script_that_needs_no_guard_around_its_work(checkout: Path) -> None:
    (checkout / "first_page.py").write_text(PAGE)
    done = subprocess.run(
        [sys.executable, "first_page.py"],
        cwd=checkout,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"^hand\.inertia 0\.0021\d+ \[0\.0021\d+, 0\.0021\d+\] kg\.m2$", done.stdout, re.M)
    check_estimates(checkout / "out" / "page" / "calibrated")


@pytest.mark.slow
def test_the_page_is_a_notebook_that_shows_plots_and_the_estimates(checkout: Path) -> None:
    cells = [nbformat.v4.new_code_cell(part) for part in PAGE.split("\n\n")]
    notebook = nbformat.v4.new_notebook(cells=cells)
    NotebookClient(
        notebook,
        timeout=None,
        startup_timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(checkout)}},
    ).execute()
    shown = [output["data"] for cell in cells for output in cell.outputs if "data" in output]
    assert sum("application/vnd.plotly.v1+json" in data for data in shown) == 2
    assert "hand.inertia" in shown[-1]["text/html"] and "95 %" in shown[-1]["text/html"]
    check_estimates(checkout / "out" / "page" / "calibrated")
