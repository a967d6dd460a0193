"""The models that come with the project, found by name, and models from a user's own file."""

from __future__ import annotations

import importlib.util
import pkgutil
from importlib import import_module
from pathlib import Path

import fmus
from fmus.errors import ModelError
from fmus.model import Model


def names() -> tuple[str, ...]:
    """Names of the models in the library: the modules of this package that define MODEL."""
    found = []
    for module in pkgutil.iter_modules(fmus.__path__):
        if not module.ispkg and hasattr(import_module(f"fmus.{module.name}"), "MODEL"):
            found.append(module.name)
    return tuple(sorted(found))


def find(name: str) -> Model:
    """The model of that name, or the one in a `.py` file that defines MODEL.

    Raises:
        ModelError: there is no such model.
    """
    if name.endswith(".py"):
        return _from_file(Path(name))
    if name not in names():
        raise ModelError(f"model '{name}'", "is not in the library", f"choose one of {', '.join(names())}")
    return import_module(f"fmus.{name}").MODEL


def source_file(model: Model) -> Path:
    """The file that defines the model's functions."""
    function = model.derivatives or model.update or model.outputs
    if function is None:
        raise ModelError(f"model {model.name}", "has no functions", "give it outputs()")
    return Path(function.__code__.co_filename)


def _from_file(path: Path) -> Model:
    if not path.is_file():
        raise ModelError(path, "no such file", "give the path of a model file")
    spec = importlib.util.spec_from_file_location(f"fmus.{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not isinstance(getattr(module, "MODEL", None), Model):
        raise ModelError(path, "defines no MODEL", "end the file with MODEL = Model(...)")
    return module.MODEL
