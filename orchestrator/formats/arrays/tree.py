"""What a file of named arrays holds, whatever its format, and the recording in it.

Structures are looked through: one whose `Data` or `values` has a `Name` or `label` beside it is a channel of that
name, as dSPACE's captures and Simulink's structures with time have them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from fmus.errors import TraceError
from orchestrator.formats.arrays.channels import ArrayChannel, distinct, recording
from orchestrator.formats.layout import MAX_VALUES, FileColumns, Layout, choose
from orchestrator.formats.recording import Recording
from orchestrator.trace import FloatArray

VALUES = ("data", "values", "value")
NAMES = ("name", "label", "title", "signalname")
UNITS = ("unit", "units")
DEEPEST = 20  # structures inside each other
MOST = 1000  # columns of a matrix among channels
ONE_MATRIX = "save one real matrix with a row a sample, or a vector a channel"


@dataclass(frozen=True)
class NumberArray:
    """Real numbers, or instants where `stamped`; `read` gives them in their shape."""

    shape: tuple[int, ...]
    read: Callable[[], FloatArray]
    kind: str = "double"
    unit: str = ""
    stamped: bool = False

    @property
    def count(self) -> int:
        return math.prod(self.shape)

    @property
    def is_vector(self) -> bool:
        return self.count == max(self.shape, default=1)

    @property
    def is_matrix(self) -> bool:
        return len(self.shape) == 2


@dataclass(frozen=True)
class Other:
    """What is neither numbers nor text nor holds any."""

    shape: tuple[int, ...]
    kind: str


@dataclass(frozen=True)
class Structure:
    """A structure, or an array of them: a mapping an element."""

    elements: Sequence[Mapping[str, Node]]


Node: TypeAlias = "NumberArray | Other | Structure | str | Sequence[Node]"
Tree: TypeAlias = Mapping[str, Node]


def read(path: Path, layout: Layout, tree: Tree) -> Recording:
    """The recording in the matrix or structure that the layout names, in the only matrix, or in the vectors.

    Raises:
        TraceError: there is none, or it does not hold what the layout says.
    """
    if layout.variable is not None:
        node = _named(path, tree, layout.variable)
        if isinstance(node, Structure) and any(channel.count > 1 for channel in _channels("", node)):
            return _of_channels(path, layout, {layout.variable: node})
        if not (isinstance(node, NumberArray) and node.is_matrix):
            what = f"is {_described(node)}, not a numeric matrix"
            raise TraceError(f"{path}: {layout.variable}", what, ONE_MATRIX)
        return _of_matrix(path, layout, layout.variable, node, tree)
    matrices = {name: node for name, node in tree.items() if isinstance(node, NumberArray) and node.is_matrix}
    tables = {name: node for name, node in matrices.items() if not node.is_vector}
    rows = {node.shape[0] for node in tables.values()}
    vectors = [
        node
        for node in tree.values()
        if isinstance(node, NumberArray)
        and node.is_vector
        and node.count > 1
        and (node.is_matrix or node.count in rows)
    ]
    named = [name for name, node in matrices.items() if node.shape[1] == 1 and _labels(tree.get("names"), 1)]
    if len(matrices) == 1 and named:  # a table of our own with nothing but times
        return _of_matrix(path, layout, named[0], matrices[named[0]], tree)
    if len(tables) == 1 and not vectors and not any(isinstance(node, Structure) for node in tree.values()):
        (found,) = tables.items()
        return _of_matrix(path, layout, *found, tree)
    if len(tables) > 1 and not vectors:
        raise TraceError(
            path, f"holds {len(tables)} numeric matrices ({_held(tree)})", "name one as `variable` in the layout"
        )
    return _of_channels(path, layout, tree)


def _of_matrix(path: Path, layout: Layout, name: str, node: NumberArray, tree: Tree) -> Recording:
    rows, count = node.shape
    place = f"{path}: {name}"
    if not 0 < node.count <= MAX_VALUES:
        raise TraceError(place, f"claims {rows} x {count} values", ONE_MATRIX)
    names, units = (_labels(tree.get(key), count) for key in ("names", "units"))
    if rows == 1 < count:
        raise TraceError(place, "is one channel", "leave `variable` out and name the vectors in `columns`")
    if names is None and rows < count:
        raise TraceError(place, f"is {rows} x {count}, fewer samples than columns", "transpose it")
    matrix = node.read()
    columns = FileColumns(count, names, units or (), head=lambda number: matrix[:, number])
    choice = choose(replace(layout, variable=name), columns, path)
    others = (channel for other, held in tree.items() if other != name for channel in _channels(other, held))
    notes = [f"'{channel.name}' holds {channel.problem} and is left out" for channel in others if channel.problem]
    return choice.recording(lambda number: matrix[:, number], notes=notes)


def _labels(node: Node | None, count: int) -> tuple[str, ...] | None:
    if not isinstance(node, (list, tuple)) or len(node) != count:
        return None
    texts = tuple(text for text in node if isinstance(text, str))
    return texts if len(texts) == count else None


def _of_channels(path: Path, layout: Layout, tree: Tree) -> Recording:
    only = next(iter(tree.values())) if len(tree) == 1 else None
    if isinstance(only, Structure) and len(only.elements) == 1:
        found = _of_element("", only.elements[0], 0)
    else:
        found = (channel for name, node in tree.items() for channel in _channels(name, node))
    channels = distinct(list(found))
    if not any(channel.count > 1 for channel in channels):
        raise TraceError(path, f"holds no numeric matrices and no vectors ({_held(tree)})", ONE_MATRIX)
    return recording(path, layout, channels)


def _channels(name: str, node: Node, depth: int = 0) -> Iterator[ArrayChannel]:
    """The vectors in a node, the columns of its matrices, what is in its structures; and what cannot be read."""
    if isinstance(node, NumberArray) and node.is_vector:
        yield ArrayChannel(name, node.unit, node.count, lambda: node.read().ravel(), stamped=node.stamped)
    elif isinstance(node, NumberArray) and node.is_matrix:
        yield from (
            ArrayChannel(f"{name}_{number}", node.unit, node.shape[0], lambda number=number: node.read()[:, number])  # type: ignore[misc]
            for number in range(min(node.shape[1], MOST))
        )
        if node.shape[1] > MOST:
            yield _unread(f"{name}_{MOST}", f"{node.shape[1] - MOST} columns more")
    elif isinstance(node, Structure) and depth < DEEPEST:
        several = len(node.elements) > 1
        for number, element in enumerate(node.elements, 1):
            yield from _of_element(f"{name}({number})" if several else name, element, depth + 1)
    elif _may_be_meant(node):
        yield _unread(name, _described(node))


def _may_be_meant(node: Node) -> bool:
    """Whether somebody may look for samples in what is no channel: in texts and single values nobody does."""
    if isinstance(node, (NumberArray, Other)):
        return math.prod(node.shape) > 1 or node.kind in ("object", "opaque")
    return isinstance(node, (list, tuple)) and any(isinstance(part, (NumberArray, Structure)) for part in node)


def _unread(name: str, problem: str) -> ArrayChannel:
    return ArrayChannel(name, "", 0, list, problem=problem)


def _of_element(name: str, element: Mapping[str, Node], depth: int) -> Iterator[ArrayChannel]:
    values = next(
        (node for key, node in element.items() if key.lower() in VALUES and isinstance(node, NumberArray)), None
    )
    label = _text(element, NAMES)
    if values is not None and label:
        yield from _channels(label, replace(values, unit=_text(element, UNITS)), depth)
        return
    axes, curves = element.get("X"), element.get("Y")
    if isinstance(axes, Structure) and isinstance(curves, Structure):
        yield from _capture(axes, curves, depth)
        element = {key: node for key, node in element.items() if key not in ("X", "Y")}
    for key, node in element.items():
        yield from _channels(f"{name}.{key}" if name else key, node, depth)


def _capture(axes: Structure, curves: Structure, depth: int) -> Iterator[ArrayChannel]:
    """Channels of a capture: curves, each over the axis with its index."""
    clocks = ["time" if number == 1 else f"time_{number}" for number in range(1, len(axes.elements) + 1)]
    for clock, axis in zip(clocks, axes.elements, strict=True):
        yield from (
            replace(channel, name=clock, clock=clock)
            for channel in _of_element(clock, {"Name": clock, **_filled(axis)}, depth)
        )
    for number, curve in enumerate(curves.elements, 1):
        index = next((node for key, node in curve.items() if key.lower() == "xindex"), None)
        place = int(index.read().flat[0]) if isinstance(index, NumberArray) and index.count == 1 else 1
        clock = clocks[place - 1] if 0 < place <= len(clocks) else ""
        named = {"Name": f"Y({number})", **_filled({key: node for key, node in curve.items() if key != "XIndex"})}
        yield from (replace(channel, clock=clock) for channel in _of_element(f"Y({number})", named, depth))


def _filled(element: Mapping[str, Node]) -> Mapping[str, Node]:
    """Without its empty texts."""
    return {key: node for key, node in element.items() if node != ""}


def _text(element: Mapping[str, Node], keys: Sequence[str]) -> str:
    found = (node.strip() for key, node in element.items() if key.lower() in keys and isinstance(node, str))
    return next(filter(None, found), "")


def _named(path: Path, tree: Tree, name: str) -> Node:
    """The node of a name; parts of structures are told by points."""
    inside: Tree = tree
    for part in [name] if name in tree else re.split(r"[./]", name):
        if part not in inside:
            raise TraceError(path, f"has no variable '{name}'", f"it holds {_held(tree)}")
        node = inside[part]
        inside = node.elements[0] if isinstance(node, Structure) and len(node.elements) == 1 else {}
    return node


def _held(tree: Tree) -> str:
    return ", ".join(f"{name} ({_described(node)})" for name, node in list(tree.items())[:20]) or "nothing"


def _described(node: Node) -> str:
    if isinstance(node, (NumberArray, Other)):
        return f"{' x '.join(map(str, node.shape))} {node.kind}".strip()
    if isinstance(node, Structure):
        return f"{len(node.elements)} struct" if len(node.elements) != 1 else "struct"
    return "char" if isinstance(node, str) else f"cell of {len(node)}"
