"""Models whose expressions are not their functions are found out."""

from __future__ import annotations

from typing import Any

import pytest

from fmus import library
from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.modelling.agreement import require_agreement
from fmus.modelling.model import Model, input_, output, parameter
from tests.support.fmus.natives import everything


def selecting(function: Any) -> Model:
    return Model(
        name="selecting",
        description="Selects",
        outputs=lambda t, x, u, p: {"y": function(u, p)},
        variables=(
            input_("a", "1", "A"),
            output("y", "1", "Y"),
            parameter("on", "1", False, "On"),
            parameter("kind", "1", 1, "Kind", minimum=1, maximum=4),
        ),
    )


@pytest.mark.parametrize("name", library.names())
def test_models_of_the_library_agree_with_their_expressions(name: str) -> None:
    require_agreement(library.find(name))


def test_a_model_of_every_function_agrees_with_its_expressions() -> None:
    require_agreement(everything())


@pytest.mark.parametrize(
    "function",
    [
        lambda u, p: ops.where(p.kind == 3, u.a, -u.a),
        lambda u, p: u.a if p.kind != 1 else -u.a,
        lambda u, p: ops.where(p.on is True, u.a, -u.a),
    ],
)
def test_a_comparison_that_symbols_answer_differently_is_found(function: Any) -> None:
    with pytest.raises(ModelError, match=r"model selecting, outputs, y: is something else .* instead of =="):
        require_agreement(selecting(function))


@pytest.mark.parametrize(
    "function",
    [lambda u, p: ops.where(ops.both(p.kind > 2.5, p.kind < 3.5), u.a, -u.a), lambda u, p: ops.where(p.on, u.a, 2.0)],
)
def test_a_choice_by_inequalities_or_by_a_truth_agrees(function: Any) -> None:
    require_agreement(selecting(function))
