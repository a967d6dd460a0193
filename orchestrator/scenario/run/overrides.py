"""Values of variables as they are written on a command line."""

from __future__ import annotations

from typing import Any

from fmus.errors import WiringError
from orchestrator.assembly.whole_arrays import written
from orchestrator.fmi.interface import Value, Written


def parse_override(text: str) -> tuple[str, Value | list[Any]]:
    """`component.variable=value` as name and value as it is written, or nested lists of these: `c.A=[[1, 2], [3, 4]]`.

    Raises:
        WiringError: there is no `=`, or the lists are none.
    """
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise WiringError(f"--set {text}", "has no value", "write component.variable=value")
    if not (value.startswith("[") and value.endswith("]")):
        return name, Written(value)
    try:
        return name, written(name, value)
    except ValueError as error:
        raise WiringError(f"--set {name}", str(error), "write component.array=[[1, 2], [3, 4]]") from None
