"""A mistake in a model's file is named by file and line, with what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus import library
from fmus.errors import ModelError
from fmus.modelling import symbolic

TANK = '''\
"""A tank that empties through a hole."""

import math

from . import Model, State, input_, ops, output, parameter


def flow(x, p):
    level = ops.maximum(x.level, 0.0)
    return p.hole * ops.sqrt(level)


def derivatives(t, x, u, p):
    return {
        "level": (u.inflow
                  - flow(x, p)) / p.area,
    }


def outputs(t, x, u, p):
    return {"outflow": flow(x, p)}


MODEL = Model(
    name="tank",
    description="Tank",
    variables=(
        input_("inflow", "m3/s", "Inflow"),
        output("outflow", "m3/s", "Outflow"),
        output("level", "m", "Level"),
        parameter("area", "m2", 1.0, "Area", minimum=1e-9),
        parameter("hole", "m2/s", 0.1, "Hole", minimum=0),
    ),
    states=(State("level", 1.0, "m"),),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=lambda p: 0.1 * p.area / p.hole,
)
'''


def message(folder: Path, old: str, new: str) -> str:
    """What is said of the tank with something else in one place."""
    assert old in TANK
    file = folder / "tank.py"
    file.write_text(TANK.replace(old, new))
    with pytest.raises(ModelError) as refused:
        symbolic.trace(library.find(str(file)))
    found = str(refused.value)
    assert found.startswith(str(file))
    return found.removeprefix(str(file))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return p.hole * ops.sqrt(level)", "return p.hole * ops.sqrt(level) if level > 0 else 0.0", ":10: `if`"),
        ("level = ops.maximum(x.level, 0.0)", "level = (x.level > 0 and p.hole > 0) * x.level", ":9: `and` or `or`"),
        ("level = ops.maximum(x.level, 0.0)", "level = (not x.level > 0) * x.level", ":9: `not`"),
        ("    level = ops", "    while x.level > 1: pass\n    level = ops", ":9: `while`"),
        ("ops.maximum(x", "max(x", ":9: max() takes numbers only; write ops.maximum"),
        ("ops.sqrt(level)", "math.sqrt(level)", ":10: math.sqrt takes numbers only; write ops.sqrt"),
        ("ops.sqrt(level)", "math.gamma(level)", ":10: math.gamma takes numbers only; use only fmus.ops"),
        ("ops.sqrt(level)", "float(level)", ":10: float() takes numbers only; leave it out"),
        ("ops.sqrt(level)", "ops.sqr(level)", ":10: ops has no 'sqr'; did you mean 'sqrt'?"),
        ("p.hole * ops", "p.whole * ops", ":10: the model has no 'whole'; did you mean 'hole'?"),
        ("u.inflow\n", "u.inflw\n", ":15: the model has no 'inflw'; did you mean 'inflow'?"),
        ("(u.inflow\n", "(gain * u.inflow\n", ":15: 'gain' is not known"),
        ('{"outflow": flow(x, p)}', "flow(x, p)", ":20, outputs: returns Mul; return a dict"),
        ('return {"outflow": flow(x, p)}', "flow(x, p)", ":20, outputs: returns NoneType; return a dict"),
        ('{"outflow"', '{"outfow"', ":20, outputs: returns nothing for outflow and 'outfow', which it returns,"),
        ("outputs(t, x, u, p)", "outputs(t, x, u)", "define it as outputs(t, x, u, p)"),
        ("p.area / p.hole,", "p.area / p.hole / 0,", ":37: divides by zero"),
        ("0.1 * p.area", "-0.1 * p.area", ":37, <lambda>: gives -1.0 at the defaults; give a time in seconds above 0"),
        ('0.1, "Hole"', 'float("nan"), "Hole"', ":24: model tank: 'hole' starts at nan"),
        ('"m2/s"', '"m2m/s"', ":32: unit 'm2m/s' of hole is not known"),
        ('1.0, "Area"', '0.0, "Area"', ":24: model tank: 'area' starts at 0"),
    ],
)
def test_a_mistake_is_named_by_its_line_with_the_fix(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in message(tmp_path, old, new)


def test_the_model_without_a_mistake_is_traced(tmp_path: Path) -> None:
    file = tmp_path / "tank.py"
    file.write_text(TANK)
    assert set(symbolic.trace(library.find(str(file))).derivatives) == {"level"}
