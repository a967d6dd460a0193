"""The packagings by name, and which one is used where nobody chose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.errors import InputError
from fmus.modelling.model import Model, Number, Table
from fmus.packaging import native, python
from fmus.packaging.native import compiler

NAMES = ("native", "python")


def preferred() -> str:
    """The packaging where nobody chose: native where there is a C compiler, else python."""
    return "native" if compiler.available() else "python"


def build(
    target: str,
    model: Model,
    path: Path,
    parameters: Mapping[str, Number] | None = None,
    tables: Mapping[str, Table] | None = None,
    fmi: int = 2,
    platforms: Sequence[str] = ("host",),
) -> Path:
    """Write the FMU of a model in one of the packagings; the path comes back.

    Raises:
        InputError: the packaging is not known or does not offer what is asked for.
        ModelError: see the packagings.
    """
    if target == "native":
        return native.build(model, path, parameters, tables, fmi, platforms)
    if target != "python":
        raise InputError(f"target '{target}'", "is not known", f"choose {' or '.join(NAMES)}")
    if fmi != 2 or tuple(platforms) != ("host",):
        raise InputError("target 'python'", "is FMI 2 and for every platform at once", "use --target native")
    return python.build(model, path, parameters, tables)
