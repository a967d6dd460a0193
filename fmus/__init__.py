"""Models of servo-driven mechanisms, and how they become FMUs::

    from fmus import Model, State, build, input_, output, parameter, write_back

A model declares variables and states and up to three functions; `build` makes an FMU of it, `write_back` puts
calibrated values into one. What is named here is loaded when it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmus.modelling import ops
    from fmus.modelling.model import Model, Requirement, State, Table, array, input_, output, parameter
    from fmus.packaging.targets import build
    from fmus.parameters.write_back import write_back

__all__ = [
    "Model",
    "Requirement",
    "State",
    "Table",
    "array",
    "build",
    "input_",
    "ops",
    "output",
    "parameter",
    "write_back",
]

_PLACES = {"build": "packaging.targets", "write_back": "parameters.write_back"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'fmus' has no attribute '{name}'")
    if name == "ops":
        return import_module("fmus.modelling.ops")
    return getattr(import_module(f"fmus.{_PLACES.get(name, 'modelling.model')}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
