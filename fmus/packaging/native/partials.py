"""Which partial derivatives of a model's equations generated C computes: those that are not zero everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import sympy

from fmus.modelling.jacobian import jacobian
from fmus.modelling.model import Model
from fmus.modelling.symbolic import trace

Partials = Mapping[tuple[str, str], sympy.Expr]
"""(result, known) -> partial derivative; those of one result follow one another."""


@dataclass(frozen=True)
class ModelPartials:
    """Partial derivatives by states, real inputs and real parameters.

    Attributes:
        rates: of the continuous states, by their names.
        outputs: of those that are no states.
        update: of the sampled states' new values.
    """

    rates: Partials
    outputs: Partials
    update: Partials


@lru_cache(maxsize=16)
def linearised(model: Model) -> ModelPartials:
    """The model's partial derivatives.

    Raises:
        ModelError: a function whose derivative is not known.
    """
    traced = trace(model, as_written=True)
    real = {variable.name for variable in model.variables if variable.type == "Real"}
    knowns = [symbol for name, symbol in traced.symbols["x"].items()]
    knowns += [symbol for kind in "up" for name, symbol in traced.symbols[kind].items() if name in real]

    def of(results: Mapping[str, sympy.Expr]) -> Partials:
        names, found = [*results], jacobian(f"model {model.name}", [*results.values()], knowns)
        return {(names[row], knowns[column].name): found[row, column] for row, column in sorted(found)}

    return ModelPartials(of(traced.derivatives), of(traced.outputs), of(traced.update))
