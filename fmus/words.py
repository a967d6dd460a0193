"""Words of messages: a name that may be meant, an article, the first of many names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint to the name that is nearly this one, or to those there are."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    return f"there are {', '.join(names[:12])}" + (", ..." if len(names) > 12 else "") if names else "there are none"


def with_article(noun: str) -> str:
    """The noun with a or an before it."""
    return f"an {noun}" if noun[0] in "aeioAEIO" else f"a {noun}"


def listed(names: Sequence[str], most: int = 4, between: str = ", ") -> str:
    """The first names, and how many more there are."""
    return between.join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
