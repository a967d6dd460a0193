"""Points that a study writes out, in its file or in a table."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.errors import ScenarioError
from orchestrator.batch.sweep.points.schema import Level, ListBlock

_HEAD = re.compile(r"\s*([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?\s*")


def columns(block: ListBlock, file: Path) -> dict[str, list[Level]]:
    """Name -> its value at each point, in the order of the points.

    Raises:
        ScenarioError: the table cannot be read, or a point lacks a value; the message names the row.
    """
    if block.points is not None:
        return _of_points(block.points, file)
    assert block.table is not None
    return _of_table(file.parent / block.table)


def _of_points(points: Sequence[Mapping[str, Level]], file: Path) -> dict[str, list[Level]]:
    names = list(points[0])
    for number, point in enumerate(points):
        if set(point) != set(names):
            problem = f"has {', '.join(point) or 'nothing'}, not {', '.join(names) or 'nothing'} as the first"
            raise ScenarioError(f"{file}: design.points.{number}", problem, "give each point a value of each")
    return {name: [point[name] for point in points] for name in names}


def _of_table(table: Path) -> dict[str, list[Level]]:
    try:
        with table.open(encoding="utf-8-sig", newline="") as opened:
            head, *lines = [line for line in csv.reader(opened) if line] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(table, f"cannot be read as CSV ({error})", "check the path") from None
    found = [_HEAD.fullmatch(cell) for cell in head]
    if not lines or not all(found):
        raise ScenarioError(table, "has no points", "give a line with names and one for each point")
    for number, line in enumerate(lines, 2):
        if len(line) != len(head) or not all(cell.strip() for cell in line):
            raise ScenarioError(f"{table}:{number}", f"has not {len(head)} values", "give each point a value of each")
    heads = [(match[1], match[2]) for match in found if match]
    return {
        name: [f"{line[place].strip()} {unit}".strip() if unit else line[place].strip() for line in lines]
        for place, (name, unit) in enumerate(heads)
    }
