"""Words of messages: a name that may be meant, an article, the first of many names, what a library complains of."""

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


def cut(text: str, most: int) -> str:
    """The text, cut to a readable length."""
    return text if len(text) <= most else text[: most - 3] + "..."


def complaint(error: object, most: int = 300) -> str:
    """A library's complaint in one line; the kind of its error where it says nothing."""
    return cut(" ".join(str(error).split()) or type(error).__name__, most)


def excerpt(error: object) -> str:
    """The first line of a library's complaint."""
    said = str(error).strip() or type(error).__name__
    return cut(said.splitlines()[0].strip().rstrip("."), 160)


def listed(names: Sequence[str], most: int = 4, between: str = ", ") -> str:
    """The first names, and how many more there are."""
    return between.join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
