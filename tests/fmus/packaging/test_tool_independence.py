"""Native FMUs in importers that none of us wrote: the same trajectories, and calibrated ones with nothing set.

Install them with `pip install 'servotwin[tools]'` (ecospy needs Debian's libtbb12); FMI4j is fetched by Maven and needs
Java. Without, the tests are skipped.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import library
from fmus.modelling.model import Table
from fmus.packaging.description import interface
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from fmus.parameters import write_back
from orchestrator.trace import FloatArray
from tests.support.fmus.moving import moving
from tests.support.fmus.stepping import stepped
from tests.support.simulation.fused import fused, many_rates, of_fmus, wired
from tests.support.tools import maven, tools

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]

STEP, COUNT = 0.01, 40
ROOT = Path(__file__).parents[3]
NAMES = library.names()
CONTINUOUS = [name for name in NAMES if interface.exchangeable(library.find(name))]
MODULES = {
    "fmuloader": "fmuloader",
    "fmuloader_exchange": "fmuloader",
    "ecos": "ecospy",
    "libcosim": "libcosimpy",
    "casadi": "casadi",
}


def cases(*tools: str) -> list[Any]:
    """A test's (tool, FMI version), each with what it needs."""
    return [
        pytest.param(tool, fmi, marks=pytest.mark.needs("java" if tool.startswith("fmi4j") else "tools"))
        for tool in tools
        for fmi in ((2,) if tool.startswith(("fmi4j", "libcosim")) else (2, 3))
    ]


@functools.cache
def missing(tool: str) -> str:
    """Why a tool cannot be used here, nothing when it can."""
    if tool.startswith("fmi4j"):
        return maven.problem(maven.FMI4J)
    if importlib.util.find_spec(MODULES[tool]) is None:
        return f"{MODULES[tool]} is not installed (pip install 'servotwin[tools]')"
    done = subprocess.run(
        [sys.executable, "-c", f"import {MODULES[tool]}"], capture_output=True, text=True, check=False
    )
    return "" if done.returncode == 0 else f"{MODULES[tool]}: {done.stderr.strip().splitlines()[-1]}"


def run(tool: str, jobs: list[dict[str, Any]]) -> list[list[list[float]]]:
    """Rows of each job, from the tool in a process of its own."""
    if missing(tool):
        pytest.skip(missing(tool))
    done = subprocess.run(
        [sys.executable, "-m", tools.__name__, tool],
        cwd=ROOT,
        input=json.dumps(jobs),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    rows: list[list[list[float]]] = json.loads(done.stdout)
    return rows


def job(path: Path, name: str, fmi: int, **more: Any) -> dict[str, Any]:
    outputs = [variable.name for variable in library.find(name).of("output")]
    return {"path": str(path), "outputs": outputs, "step": STEP, "count": COUNT, "fmi": fmi} | more


def instants() -> FloatArray:
    """The instants of the steps; each is 10 ms long as the tools count them."""
    return np.arange(COUNT + 1) * STEP


def expected(name: str, values: dict[str, float], tables: dict[str, Table] | None = None) -> FloatArray:
    outputs = [variable.name for variable in library.find(name).of("output")]
    return stepped(library.find(name), values, outputs, instants(), tables=tables)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """(name, FMI version) -> an FMU that moves with nothing set."""
    folder = tmp_path_factory.mktemp("tools")

    @functools.cache
    def build(name: str, fmi: int) -> Path:
        return native.build(library.find(name), folder / f"{name}{fmi}.fmu", moving(name), fmi=fmi)

    return build


@pytest.mark.parametrize(("tool", "fmi"), cases("fmuloader", "ecos", "libcosim", "fmi4j"))
def test_co_simulation_gives_the_trajectories_of_the_instances(built: Any, tool: str, fmi: int) -> None:
    answers = run(tool, [job(built(name, fmi), name, fmi) for name in NAMES])
    for name, rows in zip(NAMES, answers, strict=True):
        found, wanted = np.array(rows), expected(name, moving(name))
        assert found[-COUNT:] == pytest.approx(wanted[1:], rel=1e-9, abs=1e-12), name


@pytest.mark.parametrize("nested", [(), ("servo_drive", "pendulum", "excitation")], ids=["models", "fmus"])
@pytest.mark.parametrize(("tool", "fmi"), cases("fmuloader", "ecos", "libcosim", "fmi4j"))
def test_a_system_in_one_fmu_gives_the_trajectory_of_the_wired_one(
    tmp_path: Path, tool: str, fmi: int, nested: tuple[str, ...]
) -> None:
    file = many_rates(tmp_path, *of_fmus(tmp_path, 5 - fmi, *nested))
    wanted = wired(file, 3 * COUNT * 0.002)
    order = {"outputs": [*wanted.outputs], "step": 3 * 0.002, "count": COUNT, "fmi": fmi}
    [rows] = run(tool, [{"path": str(fused(file, tmp_path, fmi)), **order}])
    expected_rows = np.column_stack([*wanted.outputs.values()])[::3]
    assert np.array(rows)[-COUNT:] == pytest.approx(expected_rows[1:], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(("tool", "fmi"), cases("fmuloader_exchange", "casadi", "fmi4j_exchange"))
def test_model_exchange_gives_the_trajectories_of_the_instances(built: Any, tool: str, fmi: int) -> None:
    """The tool integrates with the inner steps of the co-simulation, so that only rounding is left."""
    jobs = []
    for name in CONTINUOUS:
        start = {state.name: moving(name).get(str(state.start), 0.0) for state in library.find(name).continuous}
        jobs.append(job(built(name, fmi), name, fmi, start=start, substeps=inner_steps(name)))
    for name, rows in zip(CONTINUOUS, run(tool, jobs), strict=True):
        assert np.array(rows) == pytest.approx(expected(name, moving(name)), rel=1e-9, abs=1e-11), name


def inner_steps(name: str) -> int:
    from fmus.modelling.instance import Instance

    instance = Instance(library.find(name), dict(moving(name)))
    step = library.find(name).solver_step
    assert step is not None
    return max(1, int(np.ceil(STEP / step(instance.p) - 1e-9)))


@pytest.mark.needs("tools")
@pytest.mark.parametrize("fmi", [2, 3])
def test_casadi_gets_the_jacobians_of_the_pendulum(tmp_path: Path, fmi: int) -> None:
    angle, speed = 0.7, 3.0
    values = {"inertia": 0.0021, "coulomb_friction_positive": 0.004}
    path = native.build(library.find("pendulum"), tmp_path / "pendulum.fmu", values, fmi=fmi)
    start = {"angle": angle, "speed": speed}
    [rows] = run("casadi", [job(path, "pendulum", fmi, count=0, start=start, jacobian=True)])
    inertia, weight = 0.0021, 0.04905
    friction = 0.5 * 0.004 * (1 + 2 * np.tanh(speed / 0.05)) * (1 - np.tanh(speed / 0.05) ** 2) / 0.05
    exact = [0, 1, 0, -weight * np.cos(angle) / inertia, -(0.001 + friction) / inertia, 1 / inertia]
    assert rows[-1] == pytest.approx(exact, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("tool", "fmi"),
    cases("fmuloader", "fmuloader_exchange", "ecos", "libcosim", "casadi", "fmi4j", "fmi4j_exchange"),
)
def test_a_calibrated_fmu_behaves_calibrated_with_nothing_set(tmp_path: Path, tool: str, fmi: int) -> None:
    plain = native.build(library.find("pendulum"), tmp_path / "plain.fmu", {"angle_start": 0.7}, fmi=fmi)
    values = {"inertia": 0.00213, "viscous_friction": 1.7e-4, "gravity_torque": 1.4e-3}
    [path] = write_back.write_back(plain, values, tmp_path / "calibrated.fmu", {"from": "a test"})
    [rows] = run(tool, [job(path, "pendulum", fmi, start={"angle": 0.7, "speed": 0.0}, substeps=1)])
    wanted = expected("pendulum", values | {"angle_start": 0.7})
    assert np.array(rows)[-COUNT:] == pytest.approx(wanted[1:], rel=1e-9, abs=1e-12)
    assert not np.allclose(wanted, expected("pendulum", {"angle_start": 0.7}), rtol=1e-3)
