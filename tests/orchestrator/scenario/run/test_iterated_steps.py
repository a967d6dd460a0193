"""A quarter car of two FMUs that a stiff suspension couples, against the exact solution of its equations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from fmus.errors import InputError, ServotwinError
from fmus.modelling.model import Model, State, input_, output, parameter
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from orchestrator.engine import Result
from orchestrator.scenario.accounts import document_of, sentence_of
from orchestrator.scenario.exchange import export
from orchestrator.scenario.fusing import fuse
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.trace import FloatArray

BODY, WHEEL, TYRE = 300.0, 30.0, 150e3  # [kg, kg, N/m]
CONTROLLED = {"tolerance": 1e-6, "least": 1e-6, "most": 0.02}
WIRES = ["body.force -> wheel.force", "wheel.height -> body.height_below", "wheel.speed -> body.speed_below"]


def body() -> Model:
    """The sprung mass and the suspension below it, whose force it tells."""

    def force(x: Any, u: Any, p: Any) -> Any:
        return p.stiffness * (x.height - u.height_below) + p.damping * (x.speed - u.speed_below)

    return Model(
        name="body",
        description="A body on its suspension",
        variables=(
            input_("height_below", "m", "Where the suspension stands"),
            input_("speed_below", "m/s", "Its speed there"),
            output("height", "m", "Height from rest"),
            output("speed", "m/s", "Vertical speed"),
            output("force", "N", "Of the suspension on what is below"),
            parameter("stiffness", "N/m", 20e3, "Of the suspension"),
            parameter("damping", "N.s/m", 1500.0, "Of the suspension"),
            parameter("height_start", "m", 0.05, "Height at the start"),
        ),
        states=(State("height", "height_start", "m"), State("speed", 0.0, "m/s")),
        derivatives=lambda t, x, u, p: {"height": x.speed, "speed": -force(x, u, p) / BODY},
        outputs=lambda t, x, u, p: {"force": force(x, u, p)},
        solver_step=lambda p: 2e-4,
    )


def wheel() -> Model:
    """The unsprung mass on its tyre."""
    return Model(
        name="wheel",
        description="A wheel on its tyre",
        variables=(
            input_("force", "N", "From above"),
            output("height", "m", "Height from rest"),
            output("speed", "m/s", "Vertical speed"),
        ),
        states=(State("height", 0.0, "m"), State("speed", 0.0, "m/s")),
        derivatives=lambda t, x, u, p: {"height": x.speed, "speed": (u.force - TYRE * x.height) / WHEEL},
        solver_step=lambda p: 2e-4,
    )


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("car")
    return {model.name: targets.build(model, folder / f"{model.name}.fmu") for model in (body(), wheel())}


def car(folder: Path, fmus: dict[str, Path], stiffness: float, damping: float, **run: Any) -> Path:
    given = {"body": {"stiffness": stiffness, "damping": damping}, "wheel": {}}
    document = {
        "title": "A quarter car",
        "components": {name: {"fmu": str(fmus[name]), "parameters": given[name]} for name in given},
        "connections": WIRES,
        "run": {"stop": 1, "step": 0.02, "order": "iterated"} | run,
    }
    (folder / "car.yaml").write_text(json.dumps(document))
    return folder / "car.yaml"


def only(result: ScenarioResult) -> Result:
    found = result.cases[0].result
    assert found is not None
    return found


def exact(time: FloatArray, k: float, c: float) -> FloatArray:
    """(K, 4) height and speed of the body and of the wheel."""
    A = np.array(
        [
            [0, 1, 0, 0],
            [-k / BODY, -c / BODY, k / BODY, c / BODY],
            [0, 0, 0, 1],
            [k / WHEEL, c / WHEEL, -(k + TYRE) / WHEEL, -c / WHEEL],
        ]
    )
    return np.array([scipy.linalg.expm(A * one) @ [0.05, 0, 0, 0] for one in time])


def states(result: Result) -> FloatArray:
    names = ("body.height", "body.speed", "wheel.height", "wheel.speed")
    return np.stack([result.trace[name] for name in names], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "damping"), [(20e3, 1500.0), (2e6, 3000.0)], ids=["soft", "stiff"])
def test_a_quarter_car_is_within_its_tolerance(
    tmp_path: Path, fmus: dict[str, Path], stiffness: float, damping: float
) -> None:
    run = {"stop": 0.2, "step": CONTROLLED | {"tolerance": 1e-5}}
    result = only(run_scenario(car(tmp_path, fmus, stiffness, damping, **run)))
    taken = result.account.taken
    assert taken is not None and taken.forced == 0
    error = np.abs(states(result) - exact(result.trace.time, stiffness, damping)).max()
    assert error < 1e-5 * taken.steps


def discarding(made: Path, longest: float, path: Path) -> Path:
    """The FMU, discarding steps that are longer [s]; the test is skipped where there is no C compiler."""
    if not compiler.available():
        pytest.skip("there is no C compiler to build the FMU with")
    with archive.opened(made) as zipped:
        files = {name: zipped.read(name) for name in zipped.namelist()}
    sources = {Path(name).name: text.decode() for name, text in files.items() if name.endswith((".c", ".h"))}
    step = "return (fmi2Status)instance_step("
    assert step in sources["fmi2.c"]
    early = f"if (communicationStepSize > {longest!r}) return fmi2Discard;"
    sources["fmi2.c"] = sources["fmi2.c"].replace(step, f"{early} {step}")
    (binary,) = [name for name in files if name.startswith("binaries/")]
    files[binary] = compiler.compile_library(sources, Path(binary).stem, compiler.host(), ())
    archive.write(path, files)
    return path


def test_a_step_that_a_component_discards_is_shortened_where_it_can_be(tmp_path: Path, fmus: dict[str, Path]) -> None:
    longest = 0.0015
    parts = fmus | {"wheel": discarding(fmus["wheel"], longest, tmp_path / "wheel.fmu")}
    run = {"stop": 0.2, "step": CONTROLLED | {"tolerance": 1e-2}}
    result = only(run_scenario(car(tmp_path, parts, 20e3, 1500.0, **run)))
    taken = result.account.taken
    assert taken is not None and taken.forced == 0
    assert (
        taken.steps >= 0.2 / longest > only(run_scenario(car(tmp_path, fmus, 20e3, 1500.0, **run))).account.taken.steps
    )
    assert np.abs(states(result) - exact(result.trace.time, 20e3, 1500.0)).max() < 1e-2
    for step in (0.02, CONTROLLED | {"least": 0.004}):
        with pytest.raises(
            ServotwinError, match=r"wheel: step from t = 0 s by 0\.\d+ s: returned discard; it did not get"
        ):
            run_scenario(car(tmp_path, parts, 20e3, 1500.0, step=step))


def test_a_stiff_suspension_bursts_without_iteration_and_is_an_error_with_steps_that_are_too_long(
    tmp_path: Path, fmus: dict[str, Path]
) -> None:
    plain = only(run_scenario(car(tmp_path, fmus, 2e6, 3000.0, order="gauss-seidel", nonfinite="allow")))
    assert not np.abs(states(plain)).max() < 1e3
    with pytest.raises(
        ServotwinError, match="body, wheel: the step from t = 0 s did not settle in 50 iterations; shorten"
    ):
        run_scenario(car(tmp_path, fmus, 2e6, 3000.0))


def test_the_energy_of_an_undamped_car_is_kept_to_the_tolerance(tmp_path: Path, fmus: dict[str, Path]) -> None:
    k, tolerance = 20e3, 1e-5
    run = {"stop": 1, "step": CONTROLLED | {"tolerance": tolerance}}
    result = only(run_scenario(car(tmp_path, fmus, k, 0.0, **run)))
    high, up, low, down = states(result).T
    kept = 0.5 * (BODY * up**2 + WHEEL * down**2 + k * (high - low) ** 2 + TYRE * low**2)
    taken = result.account.taken
    assert taken is not None
    assert np.ptp(kept) / kept[0] < tolerance * taken.steps
    plain = only(run_scenario(car(tmp_path, fmus, k, 0.0, order="gauss-seidel", step=0.002)))
    high, up, low, down = states(plain).T
    gained = 0.5 * (BODY * up**2 + WHEEL * down**2 + k * (high - low) ** 2 + TYRE * low**2)
    assert np.ptp(gained) / gained[0] > 100 * np.ptp(kept) / kept[0]


def test_what_steps_were_taken_is_told(tmp_path: Path, fmus: dict[str, Path]) -> None:
    result = run_scenario(car(tmp_path, fmus, 20e3, 1500.0, stop=0.1, step=CONTROLLED | {"tolerance": 1e-4}))
    taken = only(result).account.taken
    assert taken is not None
    assert document_of(only(result))["stepping"]["inside"]["steps"] == taken.steps > 10
    assert (
        f"in {taken.steps:,} steps down to {taken.shortest:.3g} s, {taken.rejected:,} were taken back"
        in sentence_of(result)
    )


@pytest.mark.parametrize(
    ("run", "problem"),
    [
        ({"order": "gauss-seidel", "step": CONTROLLED}, "a `step` with a tolerance needs `order: iterated`"),
        ({"step": CONTROLLED | {"least": 0.011}}, "`step.least` must be positive and at most half of `step.most`"),
        ({"step": CONTROLLED | {"tolerance": 0}}, "tolerance"),
    ],
)
def test_what_does_not_fit_together_is_refused(
    tmp_path: Path, fmus: dict[str, Path], run: dict[str, Any], problem: str
) -> None:
    with pytest.raises(InputError, match=problem):
        run_scenario(car(tmp_path, fmus, 20e3, 1500.0, **run))


def test_iterated_steps_are_not_fused(tmp_path: Path, fmus: dict[str, Path]) -> None:
    with pytest.raises(InputError, match=r"car\.yaml: run\.order: iterated steps are taken back"):
        fuse(car(tmp_path, fmus, 20e3, 1500.0))


def test_controlled_steps_go_along_in_an_ssp(tmp_path: Path, fmus: dict[str, Path]) -> None:
    file = car(tmp_path, fmus, 20e3, 1500.0, stop=0.1, step=CONTROLLED | {"tolerance": 1e-4})
    export(file, tmp_path / "car.ssp")
    assert only(run_scenario(tmp_path / "car.ssp")).trace == only(run_scenario(file)).trace
