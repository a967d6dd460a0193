"""Joins the fragments in `changes/` into the newest version of CHANGELOG.md, and removes them: `make changelog`.

A fragment is a file of lines like `Fixed: what a user notices.`; a line that goes on is indented.
"""

from __future__ import annotations

import re
import sys
import textwrap
from pathlib import Path

KINDS = ("Added", "Changed", "Fixed", "Removed")
ENTRY = re.compile(rf"(?:- )?({'|'.join(KINDS)}): (\S.*)")


def entries(fragment: Path) -> list[tuple[str, str]]:
    """(kind, text) of each entry.

    Raises:
        ValueError: a line neither begins an entry nor goes on with one.
    """
    found: list[tuple[str, str]] = []
    for number, line in enumerate(fragment.read_text(encoding="utf-8").splitlines(), 1):
        if match := ENTRY.fullmatch(line):
            found.append((match[1], match[2]))
        elif found and re.match(r"\s+\S", line):
            found[-1] = (found[-1][0], f"{found[-1][1]} {line.strip()}")
        elif line.strip():
            raise ValueError(f"{fragment.name}, line {number}: begin it with one of {', '.join(KINDS)} and a colon")
    if not found:
        raise ValueError(f"{fragment.name}: says nothing")
    return found


def joined(changelog: str, new: list[tuple[str, str]]) -> str:
    """The changelog with new entries at the end of their sections in its newest version."""
    head, newest, *older = re.split(r"^(?=## \[)", changelog, flags=re.MULTILINE)
    title, *parts = re.split(r"^### (\w+)\n", newest, flags=re.MULTILINE)
    sections = dict(zip(parts[::2], (text.strip() for text in parts[1::2]), strict=True))
    for kind, text in new:
        item = textwrap.fill(f"- {text}", 120, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        sections[kind] = f"{sections[kind]}\n{item}" if kind in sections else item
    order = [*KINDS, *(kind for kind in sections if kind not in KINDS)]
    written = [f"### {kind}\n\n{sections[kind]}\n" for kind in order if kind in sections]
    return head + "\n".join([title.strip() + "\n", *written]) + "".join(["\n" * bool(older), *older])


def main(root: Path) -> None:
    """Join all fragments; a bad one stops it before anything is written."""
    fragments = sorted((root / "changes").glob("*.md"))
    new = [entry for fragment in fragments for entry in entries(fragment)]
    changelog = root / "CHANGELOG.md"
    changelog.write_text(joined(changelog.read_text(encoding="utf-8"), new), encoding="utf-8")
    for fragment in fragments:
        fragment.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1])
