"""What a notebook sees of the package: `import fmus`."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import fmus
from fmus import library
from fmus.packaging import archive
from tests.support.ssv import read_values

FLYWHEEL = '''"""A flywheel."""
{imports}


def derivatives(t, x, u, p):
    return {{"speed": ops.clip(u.torque, -1.0, 1.0) / p.inertia}}


MODEL = Model(
    name="flywheel",
    description="A flywheel",
    variables=(
        input_("torque", "N.m", "Torque"),
        output("speed", "rad/s", "Speed"),
        parameter("inertia", "kg.m2", 0.5, "Moment of inertia", minimum=1e-6),
    ),
    states=(State("speed", 0.0, "rad/s"),),
    derivatives=derivatives,
    solver_step=lambda p: 0.1,
)
'''
NEW = "from . import Model, State, input_, ops, output, parameter"
OLD = "from . import ops\nfrom .model import Model, State, input_, output, parameter"


def flywheel(folder: Path, imports: str = NEW) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "flywheel.py"
    path.write_text(FLYWHEEL.format(imports=imports))
    return path


def test_every_word_is_there_and_documented() -> None:
    for name in fmus.__all__:
        assert getattr(fmus, name).__doc__, name
    assert {*fmus.__all__} <= {*dir(fmus)}
    with pytest.raises(AttributeError, match="module 'fmus' has no attribute 'nothing'"):
        fmus.nothing  # noqa: B018


def test_what_type_checkers_see_is_what_is_there() -> None:
    tree = ast.parse(Path(fmus.__file__).read_text())
    [block] = [node for node in tree.body if isinstance(node, ast.If)]
    seen = [alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert sorted(seen) == sorted(fmus.__all__)


def test_nothing_is_loaded_before_it_is_used() -> None:
    code = "import sys; before = {*sys.modules}; import fmus; print(*sorted({*sys.modules} - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {name for name in done.stdout.split() if name.startswith("fmus")} == {"fmus"}


@pytest.mark.parametrize("kind", [str, Path])
def test_places_are_texts_or_paths(tmp_path: Path, kind: type) -> None:
    model = flywheel(tmp_path)
    built = fmus.build(kind(model), kind(tmp_path / "out" / "wheel.fmu"), target="python")
    assert built == tmp_path / "out" / "wheel.fmu"
    [written] = fmus.write_back(kind(built), {"inertia": 0.25}, kind(tmp_path / "calibrated.fmu"))
    assert archive.read(written)["resources/defaults.txt"] == b"torque = 0.0\ninertia = 0.25\n"
    ssv = tmp_path / "values.ssv"
    ssv.write_bytes(archive.read(written)["extra/org.fmi-standard.fmi-ls-ref/calibrated.ssv"])
    assert read_values(ssv) == {"inertia": 0.25}


def test_a_model_is_given_by_name_by_file_or_as_it_is(tmp_path: Path) -> None:
    models = ("pendulum", library.find("pendulum"), library.source_file(library.find("pendulum")))
    paths = [fmus.build(model, tmp_path / f"{i}.fmu", target="python") for i, model in enumerate(models)]
    assert len({path.read_bytes() for path in paths}) == 1


@pytest.mark.parametrize("target", ["python", pytest.param("native", marks=pytest.mark.slow)])
def test_both_forms_of_the_imports_make_the_same_model(tmp_path: Path, target: str) -> None:
    """The old form, for one more release: the FMUs run alike, and start with the same values."""
    ends = []
    for form, imports in {"new": NEW, "old": OLD}.items():
        path = fmus.build(flywheel(tmp_path / form, imports), tmp_path / f"{form}.fmu", target=target)
        ends.append(run(path))
    assert ends[0] == ends[1] == pytest.approx(2.0 / 0.5)


def run(path: Path) -> float:
    """The speed after 2 s of a torque beyond the limit of 1 N.m, with FMPy alone."""
    import numpy as np
    from fmpy import simulate_fmu

    torque = np.array([(0.0, 5.0), (2.0, 5.0)], dtype=[("time", float), ("torque", float)])
    result = simulate_fmu(str(path), stop_time=2.0, output_interval=0.5, input=torque, fmi_type="CoSimulation")
    return float(result["speed"][-1])
