"""The wiring of a system as a diagram: boxes from the left to the right in the direction of the signals.

Wires between neighbouring columns run straight; those that run back, or past a column, run below all boxes, each in a
lane of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from orchestrator.report.columns import Columns

LETTER = 6.7  # width of a letter, on average [px]
LINE = 19  # of text, and from port to port [px]
HEAD, APART, CHANNEL, LANE = 60, 26, 50, 12  # of boxes, between them up and across, between wires below them [px]
AIR = 14  # around all [px]
SMALLEST = 0.75  # to what share of its size it shrinks to fit a page


@dataclass(frozen=True)
class DiagramBox:
    """A component, or what drives one.

    Attributes:
        about: what it is made of.
        rate: how often it steps.
        inputs, outputs: ports with their units, as they are shown.
        outside: whether it stands for something outside of the system, such as a stimulus.
    """

    name: str
    about: str
    rate: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    outside: bool = False

    @property
    def width(self) -> float:
        left, right = (max(map(len, ports.values()), default=0) for ports in (self.inputs, self.outputs))
        longest = max(1.15 * len(self.name), 0.92 * len(self.about), 0.92 * len(self.rate), left + right + 2.0)
        return LETTER * longest + 22

    @property
    def height(self) -> float:
        return HEAD + LINE * max(len(self.inputs), len(self.outputs)) + 6


@dataclass(frozen=True)
class DiagramWire:
    """From an output of a box to an input of one, and what is said of it."""

    source: tuple[str, str]
    target: tuple[str, str]
    about: str = ""


@dataclass(frozen=True)
class _Placed:
    """A box at its place [px], in its column."""

    box: DiagramBox
    column: int
    x: float
    y: float

    def port(self, name: str, output: bool) -> tuple[float, float]:
        ports = list(self.box.outputs if output else self.box.inputs)
        return self.x + (self.box.width if output else 0.0), self.y + HEAD + LINE * (ports.index(name) + 0.5)


@dataclass(frozen=True)
class WiringDiagram:
    """Boxes and the wires between them."""

    boxes: Sequence[DiagramBox]
    wires: Sequence[DiagramWire]

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        placed = _placed(self.boxes, self.wires)
        bottom = max((one.y + one.box.height for one in placed.values()), default=0.0)
        paths, lanes = [], 0
        for number, wire in enumerate(self.wires):
            start, end = placed[wire.source[0]], placed[wire.target[0]]
            ends = start.port(wire.source[1], True), end.port(wire.target[1], False)
            if end.column == start.column + 1:
                path = _straight(*ends)
            else:
                lanes += 1
                path = _around(*ends, bottom + APART / 2 + LANE * lanes, 8 + 5 * (number % 7))
            told = f"{'.'.join(wire.source)} → {'.'.join(wire.target)}{f' ({wire.about})' if wire.about else ''}"
            paths.append(f'<g class="wire"><title>{escape(told)}</title>{path}</g>')
        width = max((one.x + one.box.width for one in placed.values()), default=0.0) + CHANNEL
        height = bottom + APART / 2 + LANE * (lanes + 1) + AIR
        shapes = "".join(_shape(one) for one in placed.values())
        said = escape(
            f"{caption or 'Wiring'}: " + "; ".join(f"{'.'.join(w.source)} to {'.'.join(w.target)}" for w in self.wires)
        )
        return (
            f'<div class="table" tabindex="0"><svg class="wiring" role="img" aria-label="{said}" width="{width:.0f}" '
            f'style="min-width:{SMALLEST * width:.0f}px" viewBox="0 0 {width:.0f} {height:.0f}">'
            f"{''.join(paths)}{shapes}</svg></div>"
        )


def _placed(boxes: Sequence[DiagramBox], wires: Sequence[DiagramWire]) -> dict[str, _Placed]:
    """Name -> box at its place; in a column, boxes stand as what feeds them does."""
    column_of = _columns(boxes, wires)
    feeding: dict[str, list[str]] = {box.name: [] for box in boxes}
    for wire in wires:
        feeding[wire.target[0]].append(wire.source[0])
    placed: dict[str, _Placed] = {}
    x = AIR + CHANNEL / 2
    for column in range(max(column_of.values(), default=-1) + 1):
        here = [box for box in boxes if column_of[box.name] == column]

        def height(box: DiagramBox) -> float:
            above = [placed[name].y for name in feeding[box.name] if name in placed]
            return sum(above) / len(above) if above else 0.0

        y = float(AIR)
        for box in sorted(here, key=height):
            placed[box.name] = _Placed(box, column, x, y)
            y += box.height + APART
        x += max((box.width for box in here), default=0.0) + CHANNEL
    return placed


def _columns(boxes: Sequence[DiagramBox], wires: Sequence[DiagramWire]) -> dict[str, int]:
    """Name -> its column: right of all that feeds it, but for wires that close a circle."""
    targets: dict[str, list[str]] = {box.name: [] for box in boxes}
    for wire in wires:
        targets[wire.source[0]].append(wire.target[0])
    order = list(_in_order(targets, [box.name for box in boxes]))
    place = {name: number for number, name in enumerate(order)}
    column = dict.fromkeys(order, 0)
    for name in order:
        for target in targets[name]:
            if place[target] > place[name]:
                column[target] = max(column[target], column[name] + 1)
    return column


def _in_order(targets: Mapping[str, Sequence[str]], names: Sequence[str]) -> Iterator[str]:
    """The names, each before what it feeds where no circle forbids it; those that nothing feeds begin."""
    fed = {target for found in targets.values() for target in found}
    done: dict[str, None] = {}
    seen: set[str] = set()
    for first in sorted(names, key=lambda name: name in fed):
        stack = [] if first in seen else [(first, iter(targets[first]))]
        seen.add(first)
        while stack:
            name, rest = stack[-1]
            target = next((one for one in rest if one not in seen), None)
            if target is None:
                done[name] = None
                stack.pop()
            else:
                seen.add(target)
                stack.append((target, iter(targets[target])))
    yield from reversed(list(done))


def _straight(start: tuple[float, float], end: tuple[float, float]) -> str:
    (x, y), (to_x, to_y) = start, end
    middle = (x + to_x) / 2
    bend = f"{middle:.1f} {y:.1f} {middle:.1f} {to_y:.1f}"
    return f'<path d="M{x:.1f} {y:.1f}C{bend} {to_x - 6:.1f} {to_y:.1f}"/>{_tip(*end)}'


def _around(start: tuple[float, float], end: tuple[float, float], lane: float, out: float) -> str:
    (x, y), (to_x, to_y) = start, end
    return (
        f'<path d="M{x:.1f} {y:.1f}h{out:.1f}V{lane:.1f}H{to_x - 6 - out:.1f}V{to_y:.1f}H{to_x - 6:.1f}"/>{_tip(*end)}'
    )


def _tip(x: float, y: float) -> str:
    return f'<path class="tip" d="M{x:.1f} {y:.1f}l-8 -4v8z"/>'


def _shape(placed: _Placed) -> str:
    box, x, y = placed.box, placed.x, placed.y
    kind = "box outside" if box.outside else "box"
    texts = [
        f'<text class="name" x="{x + box.width / 2:.1f}" y="{y + 19:.1f}">{escape(box.name)}</text>',
        f'<text class="about" x="{x + box.width / 2:.1f}" y="{y + 36:.1f}">{escape(box.about)}</text>',
        f'<text class="about" x="{x + box.width / 2:.1f}" y="{y + 50:.1f}">{escape(box.rate)}</text>',
    ]
    for ports, output in ((box.inputs, False), (box.outputs, True)):
        for name, shown in ports.items():
            across, up = placed.port(name, output)
            side, inwards = ("out", -9) if output else ("in", 9)
            texts.append(f'<text class="{side}" x="{across + inwards:.1f}" y="{up + 4:.1f}">{escape(shown)}</text>')
    return (
        f'<g class="{kind}"><rect x="{x:.1f}" y="{y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="8"/>'
        f"{''.join(texts)}</g>"
    )
