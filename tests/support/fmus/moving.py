"""Values that move the outputs of a model, inputs included: for tests that set nothing in the FMUs they run."""

from __future__ import annotations

from fmus import library
from tests.support.fmus.natives import RICH


def moving(name: str) -> dict[str, float]:
    """Inputs and parameters of a model, by name."""
    return {variable.name: 0.7 for variable in library.find(name).of("input")} | RICH[name]
