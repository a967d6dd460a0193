"""A wiring diagram shows every component, port and wire once, none on top of another."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import combinations, pairwise

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.report.columns import Columns
from orchestrator.report.wiring import DiagramBox, DiagramWire, WiringDiagram


@st.composite
def wirings(draw: st.DrawFn) -> WiringDiagram:
    """Systems of any shape, with circles and wires back to the same box."""
    count = draw(st.integers(1, 7))
    names = [f"box {number}" for number in range(count)]
    sizes = [(draw(st.integers(1, 3)), draw(st.integers(1, 3))) for _ in names]
    boxes = [
        DiagramBox(
            name,
            "a model",
            "every 1 s",
            {f"u{i}": f"u{i} [V]" for i in range(inputs)},
            {f"y{i}": f"y{i}" for i in range(outputs)},
        )
        for name, (inputs, outputs) in zip(names, sizes, strict=True)
    ]
    ends = st.tuples(st.sampled_from(boxes), st.sampled_from(boxes))
    wires = [
        DiagramWire(
            (one.name, draw(st.sampled_from(list(one.outputs)))), (two.name, draw(st.sampled_from(list(two.inputs))))
        )
        for one, two in draw(st.lists(ends, max_size=12))
    ]
    return WiringDiagram(boxes, wires)


def rectangles(svg: str) -> list[tuple[float, float, float, float]]:
    """x, y, width, height of each box [px]."""
    found = re.findall(r'<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', svg)
    return [tuple(map(float, one)) for one in found]  # type: ignore[misc]


@given(wirings())
def test_every_box_and_wire_is_drawn_once_and_no_box_lies_on_another(wiring: WiringDiagram) -> None:
    svg = wiring.markup("1", Columns())
    boxes = rectangles(svg)
    assert len(boxes) == len(wiring.boxes)
    assert svg.count('<g class="wire">') == len(wiring.wires)
    for (x, y, wide, tall), (other_x, other_y, other_wide, other_tall) in combinations(boxes, 2):
        apart = x + wide <= other_x or other_x + other_wide <= x or y + tall <= other_y or other_y + other_tall <= y
        assert apart
    width, height = map(float, re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)[0])
    assert all(x + wide <= width and y + tall <= height for x, y, wide, tall in boxes)


@given(wirings())
def test_every_wire_begins_at_an_output_and_ends_at_an_input(wiring: WiringDiagram) -> None:
    svg = wiring.markup("1", Columns())
    boxes = rectangles(svg)
    left, right = {round(x, 1) for x, *_ in boxes}, {round(x + wide, 1) for x, _, wide, _ in boxes}
    starts = re.findall(r'<title>.*?</title><path d="M([\d.]+) ', svg)
    tips = re.findall(r'class="tip" d="M([\d.]+) ', svg)
    assert all(any(abs(float(x) - end) < 0.2 for end in right) for x in starts)
    assert all(any(abs(float(x) - end) < 0.2 for end in left) for x in tips)


CHAIN = ["controller", "drive", "arm"]
FORWARD = [DiagramWire((one, "y"), (two, "u")) for one, two in pairwise(CHAIN)]


def chain(names: Iterable[str], wires: list[DiagramWire]) -> str:
    return WiringDiagram([DiagramBox(name, "", "", {"u": "u"}, {"y": "y"}) for name in names], wires).markup(
        "1", Columns()
    )


def from_the_left(svg: str) -> list[str]:
    places = {name: float(x) for x, name in re.findall(r'class="name" x="([\d.]+)" y="[\d.]+">(.*?)<', svg)}
    return sorted(places, key=lambda name: places[name])


def test_a_chain_runs_from_the_left_to_the_right_however_it_is_listed() -> None:
    assert from_the_left(chain(reversed(CHAIN), FORWARD)) == CHAIN


def test_feedback_runs_below_all_to_the_component_that_is_listed_first() -> None:
    svg = chain(CHAIN, [*FORWARD, DiagramWire(("arm", "y"), ("controller", "u"))])
    assert from_the_left(svg) == CHAIN
    [lane] = map(float, re.findall(r"h[\d.]+V([\d.]+)H", svg))
    assert lane > max(y + tall for _, y, _, tall in rectangles(svg))


def test_a_wire_that_passes_a_box_runs_below_it() -> None:
    boxes = [DiagramBox(name, "", "", {"u": "u"}, {"y": "y"}) for name in "abc"]
    wires = [
        DiagramWire(("a", "y"), ("b", "u")),
        DiagramWire(("b", "y"), ("c", "u")),
        DiagramWire(("a", "y"), ("c", "u")),
    ]
    svg = WiringDiagram(boxes, wires).markup("1", Columns())
    assert len(re.findall(r"h[\d.]+V([\d.]+)H", svg)) == 1


def test_a_deep_chain_is_drawn() -> None:
    boxes = [DiagramBox(f"b{i}", "", "", {"u": "u"}, {"y": "y"}) for i in range(3000)]
    wires = [DiagramWire((f"b{i}", "y"), (f"b{i + 1}", "u")) for i in range(2999)]
    assert WiringDiagram(boxes, wires).markup("1", Columns()).count("<rect") == 3000
