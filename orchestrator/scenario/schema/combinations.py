"""Cases of a scenario as all combinations of a few axes: what is left out, and how each is called."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import product

from fmus.words import nearest

MOST = 10_000  # cases of a matrix
_FIELD = re.compile(r"\{([^{}]*)\}")

Combination = Mapping[str, str]
"""axis -> level."""
Selection = Mapping[str, Collection[str]]
"""axis -> levels; those of axes that are not named are all meant."""


def combinations(axes: Mapping[str, Sequence[str]], excluded: Sequence[Selection]) -> list[Combination]:
    """All combinations of the levels of each axis but those that a selection excludes; the last axis changes fastest.

    Raises:
        ValueError: there are too many, or none is left.
    """
    count = math.prod(map(len, axes.values()))
    if count > MOST:
        sizes = " x ".join(f"{len(levels):,}" for levels in axes.values())
        raise ValueError(f"the matrix has {count:,} cases ({sizes}), more than {MOST:,}; leave out levels, or `sweep`")
    made: list[Combination] = [dict(zip(axes, levels, strict=True)) for levels in product(*axes.values())]
    left = [one for one in made if not any(selects(selection, one) for selection in excluded)]
    if not left:
        raise ValueError("the matrix has no cases; exclude fewer")
    return left


def selects(selection: Selection, one: Combination) -> bool:
    """Whether a combination is among those that are selected."""
    return all(one[axis] in levels for axis, levels in selection.items())


def named(template: str | None, one: Combination) -> str:
    """The name of a combination: the template with the level of each `{axis}` in its place; else all levels."""
    if template is None:
        return ", ".join(one.values())
    return _FIELD.sub(lambda found: one[found[1]], template)


def check_selection(selection: Selection, axes: Mapping[str, Sequence[str]]) -> None:
    """See that all its axes and levels are there.

    Raises:
        ValueError: one is not.
    """
    for axis, levels in selection.items():
        _known("axis", axis, axes)
        for level in levels:
            _known(f"level of {axis}", level, axes[axis])


def check_template(template: str, axes: Iterable[str]) -> None:
    """See that a template for names has all axes, so that names differ, and nothing else.

    Raises:
        ValueError: it has not.
    """
    fields, known = _FIELD.findall(template), list(axes)
    for name in fields:
        _known("axis", name, known)
    if missing := [axis for axis in known if axis not in fields]:
        raise ValueError(f"`name` lacks {{{missing[0]}}}, so cases would not differ; add it")


def _known(what: str, name: str, known: Iterable[str]) -> None:
    if name not in (names := list(known)):
        raise ValueError(f"there is no {what} '{name}'; {nearest(name, names)}")
