"""Studies: the table of methods, and a study file read by the schema of its method."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeGuard

from fmus.errors import ScenarioError
from identification.method import Method
from identification.recordings.schema import StudyBlock
from orchestrator.plugins import plugins
from orchestrator.yaml_file import Block, load_as

METHODS = {
    "output-error": "identification.output_error.method",
    "resonance": "identification.resonance.method",
    "subspace": "identification.subspace.method",
    "experiments": "identification.experiments.method",
    "motion": "identification.motion.method",
    "inverse-dynamics": "identification.inverse_dynamics.method",
    "design": "identification.design.method",
    "tune": "identification.tuning.method",
    "tune-simulated": "identification.tuning.simulated.method",
}
"""name -> module of the methods here, each with a METHOD, imported when a study asks for it; other packages add theirs
as entry points of `servotwin.methods`."""


@dataclass(frozen=True)
class Study:
    """A study file that has been read.

    Attributes:
        block: its contents, an instance of `method.schema`.
    """

    file: Path
    method: Method[Any, Any]
    block: Any

    @property
    def base(self) -> Path:
        """The folder to which its paths are relative."""
        return self.file.parent


class _Kind(Block):
    """The key that tells which schema a study file has."""

    model_config = Block.model_config | {"extra": "ignore"}
    method: str


def method(name: str, place: str = "method") -> Method[Any, Any]:
    """The method of this name.

    Raises:
        ScenarioError: there is none; `place` is where it was asked for.
    """
    found: Method[Any, Any] | None = import_module(METHODS[name]).METHOD if name in METHODS else _added().get(name)
    if found is None:
        raise ScenarioError(place, f"'{name}' is unknown", f"use {' or '.join(names())}")
    return found


def names() -> list[str]:
    """The names of all methods."""
    return [*METHODS, *(name for name in _added() if name not in METHODS)]


def _added() -> dict[str, Method[Any, Any]]:
    return plugins("servotwin.methods", _is_method)


def _is_method(loaded: object) -> TypeGuard[Method[Any, Any]]:
    return isinstance(loaded, Method)


def load_study(path: str | Path) -> Study:
    """The study in a file.

    Raises:
        ScenarioError: it does not fit the schema of its method.
    """
    file = Path(path)
    block: StudyBlock = load_as(file, _Kind, lambda kind: method(kind.method, f"{file}: method").schema)
    return Study(file, method(block.method), block)
