"""A command loads the libraries that it uses, and no others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fmus.packaging import targets
from tests.support.identification import small_study

HEAVY = {
    *("asammdf", "can", "cantools", "control", "fmpy", "lxml", "numpy", "pandas", "plotly", "pyarrow", "pythonfmu"),
    *("rich", "ruamel", "scipy", "serial", "sympy"),
}
COMMAND = """
import sys
from identification.cli import main
try:
    main()
finally:
    print([".".join(name.split(".")[:{parts}]) for name in sys.modules], file=sys.stderr)
"""


def modules(*arguments: str, parts: int = 1) -> set[str]:
    """What a command has loaded at its end, by so many parts of the names."""
    code = COMMAND.format(parts=parts)
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    return {*eval(done.stderr.splitlines()[-1])}


def loaded(*arguments: str) -> set[str]:
    """The heavy libraries that a command has loaded at its end."""
    return HEAVY & modules(*arguments)


@pytest.mark.parametrize("arguments", [("--help",), ("run", "--help"), ("can", "bridge", "--help")])
def test_help_loads_none(arguments: tuple[str, ...]) -> None:
    assert loaded(*arguments) == set()


def test_a_table_is_looked_at_with_what_reads_it_alone(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time [s],angle [rad]\n0.0,1.0\n0.1,\n0.2,3.0\n")
    assert loaded("info", str(tmp_path / "t.csv")) == {"numpy", "pyarrow", "rich"}


def test_an_fmu_is_looked_at_without_what_builds_or_runs_it(tmp_path: Path) -> None:
    path = targets.build("pendulum", tmp_path / "p.fmu", target="python")
    assert loaded("info", str(path)) == {"fmpy", "lxml", "numpy", "rich"}


@pytest.mark.slow
def test_a_short_fit_is_done_in_its_process_without_the_large_parts_of_scipy(tmp_path: Path) -> None:
    data = small_study.record(tmp_path / "data")
    study = small_study.write_study(tmp_path / "study.yaml")
    found = modules("calibrate", str(study), "--data", str(data), "--out", str(tmp_path / "out"), parts=2)
    assert "scipy.linalg" in found and (tmp_path / "out" / "report.html").is_file()
    dear = {"can", "pandas", "scipy.optimize", "scipy.signal", "scipy.stats", "multiprocessing.forkserver"}
    assert found & dear == set()


def test_a_run_of_an_fmu_loads_no_scipy(tmp_path: Path) -> None:
    targets.build("pendulum", tmp_path / "hand.fmu", target="python")
    (tmp_path / "fall.yaml").write_text(
        "title: A fall\ncomponents: {hand: {fmu: hand.fmu}}\nrun: {stop: 0.1, step: 0.01}\n"
        "expect: [{signal: hand.speed, above: -100}]\n"
    )
    found = loaded("run", str(tmp_path / "fall.yaml"), "--out", str(tmp_path / "out"))
    assert "fmpy" in found and not found & {"control", "pandas", "plotly", "scipy", "sympy"}


def test_what_a_notebook_begins_with_loads_nothing() -> None:
    code = "import sys, fmus, orchestrator, identification; print([*sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert HEAVY & {name.partition(".")[0] for name in eval(done.stdout)} == set()


def test_sympy_is_for_tracing_alone() -> None:
    code = "import sys, fmus.library, fmus.packaging.targets, fmus.packaging.linear, orchestrator.assembly.assembly\n"
    code += "fmus.Model, fmus.build, fmus.write_back, fmus.library.find('pendulum'); print('sympy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
