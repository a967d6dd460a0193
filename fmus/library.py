"""The models that come with the project, found by name, and models from a user's own file."""

from __future__ import annotations

import ast
import pkgutil
import sys
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

from fmus import models, units
from fmus.errors import ModelError
from fmus.files import absence
from fmus.modelling.mistakes import at, in_file
from fmus.modelling.model import Model, Table, namespace, start_values

# What a model file finds wherever its FMU is run, with the standard library.
BESIDE_A_MODEL = (*(f".{name}" for name in models.__all__), ".model")
RESERVED = ("ops", "model")
_ROOT = Path(models.__path__[0]).resolve()


@cache
def _places() -> dict[str, str]:
    """Name of a model in the library -> its module, in whichever room that lies."""
    inside = pkgutil.walk_packages(models.__path__, f"{models.__name__}.")
    return {module.name.rpartition(".")[2]: module.name for module in inside if not module.ispkg}


def names() -> tuple[str, ...]:
    """Names of the models in the library."""
    return tuple(sorted(_places()))


def file_of(name: str) -> Path | None:
    """The file of the model of that name in the library, None where there is none."""
    place = _places().get(name)
    return None if place is None else _ROOT.joinpath(*place.split(".")[2:]).with_suffix(".py")


def holds(file: Path) -> bool:
    """Whether a file is a model of the library."""
    return file.name != "__init__.py" and _ROOT in file.resolve().parents


def find(name: str) -> Model:
    """The model of that name, or the one in a `.py` file that defines MODEL.

    Raises:
        ModelError: there is no such model, or its file cannot be used.
    """
    if name.endswith(".py"):
        return _from_file(Path(name))
    if name not in _places():
        raise ModelError(f"model '{name}'", "is not in the library", f"choose one of {', '.join(names())}")
    model: Model = import_module(_places()[name]).MODEL
    return model


def of_size(model: Model, shapes: Mapping[str, tuple[int, ...]]) -> Model:
    """The model with arrays of these shapes where it comes in any size; as it is otherwise."""
    if model.sized is None or not all(size for shape in shapes.values() for size in shape):
        return model
    return model.sized({**model.arrays, **shapes})


def source_file(model: Model) -> Path:
    """The file that defines the model's functions."""
    function = model.derivatives or model.update or model.outputs
    if function is None:
        raise ModelError(f"model {model.name}", "has no functions", "give it outputs()")
    return Path(function.__code__.co_filename)


def _from_file(path: Path) -> Model:
    if not path.is_file():
        raise ModelError(path, absence(path), "give the path of a model file")
    if not path.stem.isidentifier() or path.stem in RESERVED:
        raise ModelError(path, f"'{path.stem}' cannot be a module's name here", "rename the file")
    module = ModuleType(f"fmus.models.{path.stem}")
    module.__file__ = str(path)
    module.__package__ = "fmus.models"
    try:
        text = path.read_bytes()
        _refuse_foreign_imports(path, ast.parse(text))
        exec(compile(text, path, "exec"), module.__dict__)  # not by way of a .pyc, which may be older than it looks
        model = getattr(module, "MODEL", None)
        if not isinstance(model, Model):
            raise ModelError(path, "defines no MODEL", "end the file with MODEL = Model(...)")
        _refuse_garbled_units(path, model)
        _try_solver_step(model)
    except ModelError:
        raise
    except Exception as error:
        raise in_file(str(path), error) from error
    return model


def _refuse_garbled_units(path: Path, model: Model) -> None:
    """A word of one's own may be a unit ("counts"), but what is composed has to be spelt as other tools read it."""
    named = {variable.name: variable.unit for variable in model.variables}
    for name, unit in ({state.name: state.unit for state in model.states} | named).items():
        if set(unit) & set("./*^ ") and not units.spelt_as_in_fmi(unit):
            lines = path.read_text(encoding="utf-8").splitlines()
            line = next((number for number, text in enumerate(lines, 1) if unit in text), 1)
            fix = 'join known ones by dots and a slash, as in "N.m.s/rad"'
            raise ModelError(f"{path}:{line}", f"unit '{unit}' of {name} is not known", fix)


def _try_solver_step(model: Model) -> None:
    """See that the inner step is one at the parameters' defaults."""
    if model.solver_step is None:
        return
    step = model.solver_step(namespace({**start_values(model), **{name: Table(name) for name in model.tables}}))
    if not (isinstance(step, int | float) and step > 0):
        raise ModelError(at(model.solver_step), f"gives {step!r} at the defaults", "give a time in seconds above 0")


def _refuse_foreign_imports(path: Path, tree: ast.Module) -> None:
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    for node in statements:
        for name in _imported(node):
            if name not in BESIDE_A_MODEL and name.split(".")[0] not in sys.stdlib_module_names:
                raise ModelError(
                    f"{path}:{node.lineno}",
                    f"imports '{name}', which the FMU would not find",
                    "use `from . import Model, ops, ...`",
                )


def _imported(node: ast.Import | ast.ImportFrom) -> list[str]:
    """Modules that a statement imports; relative ones with their dots."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    dots = "." * node.level
    return [dots + node.module] if node.module else [dots + alias.name for alias in node.names]
