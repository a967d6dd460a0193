"""Values given to a build: checked against what the model declares, in the form in which they travel inside an FMU."""

from __future__ import annotations

import math
from collections.abc import Mapping

from fmus.errors import ModelError
from fmus.modelling.model import Model, Number, Table, start_values


def checked(model: Model, parameters: Mapping[str, Number], tables: Mapping[str, Table]) -> dict[str, Number]:
    """The start value of every input and parameter, with these in place of the model's own.

    Raises:
        ModelError: a parameter or table the model does not have, a value of the wrong type or out of bounds.
    """
    starts = start_values(model)
    _known(model, "variable", parameters, starts)
    _known(model, "table", tables, model.tables)
    return starts | {name: _typed(model, name, value) for name, value in parameters.items()}


def csv(table: Table) -> bytes:
    """The samples as lines `time,value` below a heading; every bit kept."""
    rows = (f"{float(time)!r},{float(value)!r}\n" for time, value in zip(table.time, table.values, strict=True))
    return ("time,value\n" + "".join(rows)).encode()


def _known(model: Model, what: str, given: Mapping[str, object], known: Mapping[str, object] | tuple[str, ...]) -> None:
    for name in given:
        if name not in known:
            raise ModelError(f"{model.name}.{name}", f"no such {what}", f"it has {', '.join(known) or 'none'}")


def _typed(model: Model, name: str, value: Number) -> Number:
    """The value in the variable's own type."""
    variable = model.by_name[name]
    place = f"{model.name}.{name}"
    typed = type(variable.start)(value)  # type: ignore[misc]
    if typed != value or not math.isfinite(typed):
        raise ModelError(place, f"{value} is no {variable.type} value", f"its default is {variable.start}")
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    if not low <= typed <= high:
        raise ModelError(place, f"{value} is outside {low:g} to {high:g}", "give a value within the bounds")
    return typed
