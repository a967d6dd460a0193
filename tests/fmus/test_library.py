"""Models found by name, and models from a user's own file with everything that may be wrong with it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from fmus import library
from fmus.errors import ModelError
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance

OWN = '''"""A first-order lag."""
import math

from . import ops
from .model import Model, State, input_, output, parameter


def derivatives(t, x, u, p):
    return {"level": (u.inflow - x.level) / p.lag}


MODEL = Model(
    name="lag",
    description="First-order lag",
    variables=(
        input_("inflow", "1", "Input"), output("level", "1", "Output"), parameter("lag", "s", 0.5, "Time constant"),
    ),
    states=(State("level"),),
    derivatives=derivatives,
    solver_step=lambda p: 0.1 * p.lag,
)
'''


def own(folder: Path, text: str = OWN, name: str = "lag.py") -> str:
    file = folder / name
    file.write_text(text)
    return str(file)


def refusal(name: str) -> str:
    with pytest.raises(ModelError) as error:
        library.find(name)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_library_holds_the_models_of_the_rig() -> None:
    assert {"pendulum", "dc_motor", "energy_controller", "excitation", "daq"} <= set(library.names())


@pytest.mark.parametrize("name", library.names())
def test_each_model_of_the_library_has_the_name_and_the_file_it_is_found_by(name: str) -> None:
    model = library.find(name)
    assert model.name == name
    assert library.source_file(model).name == f"{name}.py"


@pytest.mark.parametrize("name", ["pendulm", "ops", "errors", "packaging", "packaging.python", "", "../pendulum", "os"])
def test_a_name_that_is_no_model_is_refused_with_the_names_there_are(name: str) -> None:
    message = refusal(name)
    assert message.startswith(f"model '{name}': is not in the library")
    assert "pendulum" in message


def test_a_users_own_file_gives_a_model_that_runs_and_can_be_traced(tmp_path: Path) -> None:
    model = library.find(own(tmp_path))
    instance = Instance(model, {"inflow": 1.0})
    instance.step(0.0, 0.5)
    assert instance.get("level") == pytest.approx(0.632120558, rel=1e-5)
    assert symbolic.feed_through(model) == {"level": ()}
    assert library.source_file(model) == tmp_path / "lag.py"


def test_a_users_own_file_does_not_become_a_part_of_the_package(tmp_path: Path) -> None:
    library.find(own(tmp_path))
    assert "fmus.models.lag" not in sys.modules


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert refusal(str(tmp_path / "none.py")).endswith("no such file; give the path of a model file")


@pytest.mark.parametrize("name", ["my-lag.py", "2lag.py", "ops.py", "model.py"])
def test_a_file_name_that_could_not_travel_is_refused(tmp_path: Path, name: str) -> None:
    assert "rename the file" in refusal(own(tmp_path, name=name))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("MODEL = Model(", "OTHER = Model(", "defines no MODEL"),
        ("def derivatives(t", "def derivatives t", ":8: is no Python: "),
        ('State("level")', 'State("level", "depth")', "starts at 'depth', which is no parameter"),
        ("derivatives=derivatives", "derivatives=derivative", "'derivative' is not known"),
        ("variables=", "variable=", "unexpected keyword argument 'variable'"),
        ('"""A first', '"""\x00A first', "null bytes"),
        ("import math", "import numpy as np", "imports 'numpy', which the FMU would not find"),
        ("import math", "import math, scipy.signal", "imports 'scipy.signal'"),
        ("from . import ops", "from fmus import ops", "imports 'fmus'"),
        ("from . import ops", "from . import ops, daq", "imports '.daq'"),
        ("from . import ops", "from .. import fmus", "imports '..fmus'"),
        ("import math", "raise RuntimeError('no')", ":2: RuntimeError: no"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_the_reason(
    tmp_path: Path, old: str, new: str, problem: str
) -> None:
    assert old in OWN
    name = own(tmp_path, OWN.replace(old, new))
    message = refusal(name)
    assert message.startswith(name)
    assert problem in message
