"""Studies: the table of methods, and a study file read by the schema of its method."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from fmus.errors import ScenarioError
from identification.method import Method
from identification.recordings.schema import StudyBlock
from orchestrator.yaml_file import Block, load_as

GROUP = "servotwin.methods"
METHODS = {
    "output-error": "identification.output_error.method:METHOD",
    "resonance": "identification.resonance.method:METHOD",
    "subspace": "identification.subspace.method:METHOD",
    "experiments": "identification.experiments.method:METHOD",
}
"""name -> where the method is; it is imported when a study asks for it."""


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


def methods() -> dict[str, EntryPoint]:
    """name -> where each method is, those of other packages (entry points `servotwin.methods`) too."""
    others = {point.name: point for point in entry_points(group=GROUP)}
    return others | {name: EntryPoint(name, place, GROUP) for name, place in METHODS.items()}


def method(name: str, place: str = "method") -> Method[Any, Any]:
    """The method of this name.

    Raises:
        ScenarioError: there is none; `place` is where it was asked for.
    """
    known = methods()
    if name not in known:
        raise ScenarioError(place, f"'{name}' is unknown", f"use {' or '.join(known)}")
    found: Method[Any, Any] = known[name].load()
    return found


def load_study(path: str | Path) -> Study:
    """The study in a file.

    Raises:
        ScenarioError: it does not fit the schema of its method.
    """
    file = Path(path)
    block: StudyBlock = load_as(file, _Kind, lambda kind: method(kind.method, f"{file}: method").schema)
    return Study(file, method(block.method), block)
