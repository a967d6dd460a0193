"""The plan: ticks, running order, and circles of direct feed-through."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import WiringError
from orchestrator.engine import REFUSED, CycleSettings, Order, Plan, make_plan
from orchestrator.system import Part, System
from tests.support.simulation.scripted import Gain, Plant, Scripted, interface, system

STEP = Fraction(1, 100)
ITERATE = CycleSettings()


def plan(wired: System, order: Order = Order.GAUSS_SEIDEL, cycles: CycleSettings = ITERATE) -> Plan:
    return make_plan(wired, STEP, order, cycles)


def names(count: int) -> list[str]:
    return [f"c{i}" for i in range(count)]


def gains(edges: list[tuple[int, int]], count: int) -> System:
    """Gains with one input for each edge that comes in; edges (from, to)."""
    incoming = [[a for a, b in edges if b == each] for each in range(count)]
    parts = [
        Gain(name, np.ones((1, max(1, len(sources))))) for name, sources in zip(names(count), incoming, strict=True)
    ]
    links = [f"c{a}.y0 -> c{b}.u{i}" for b, sources in enumerate(incoming) for i, a in enumerate(sources)]
    return system(parts, links)


@st.composite
def digraphs(draw: st.DrawFn) -> tuple[list[tuple[int, int]], int]:
    count = draw(st.integers(1, 7))
    node = st.integers(0, count - 1)
    return sorted(draw(st.sets(st.tuples(node, node), max_size=12))), count


def reachable(edges: list[tuple[int, int]], count: int) -> np.ndarray:
    """[a, b]: whether a path of at least one edge leads from a to b."""
    paths = np.zeros((count, count), dtype=bool)
    for a, b in edges:
        paths[a, b] = True
    for middle in range(count):
        paths |= np.outer(paths[:, middle], paths[middle])
    return paths


@given(digraphs())
def test_groups_are_the_classes_of_mutual_reachability(graph: tuple[list[tuple[int, int]], int]) -> None:
    edges, count = graph
    paths = reachable(edges, count)
    together = (paths & paths.T) | np.eye(count, dtype=bool)
    groups = plan(gains(edges, count)).groups
    assert sorted(sum(groups, ())) == names(count)
    for group in groups:
        members = {int(name[1:]) for name in group}
        assert all(set(np.flatnonzero(together[each]).tolist()) == members for each in members)


@given(digraphs())
def test_whoever_reacts_at_once_runs_before_those_who_use_it(graph: tuple[list[tuple[int, int]], int]) -> None:
    edges, count = graph
    groups = plan(gains(edges, count)).groups
    position = {name: i for i, group in enumerate(groups) for name in group}
    assert all(position[f"c{a}"] <= position[f"c{b}"] for a, b in edges)


@given(digraphs())
def test_a_circle_is_refused_exactly_where_there_is_one_and_the_path_is_real(
    graph: tuple[list[tuple[int, int]], int],
) -> None:
    edges, count = graph
    if not reachable(edges, count).diagonal().any():
        assert all(len(group) == 1 for group in plan(gains(edges, count), cycles=REFUSED).groups)
        return
    with pytest.raises(WiringError, match="direct feed-through runs in a circle: ") as refused:
        plan(gains(edges, count), cycles=REFUSED)
    path = [int(name[1:]) for name in refused.value.problem.split(": ")[1].split(" -> ")]
    assert path[0] == path[-1]
    assert all(step in edges for step in pairwise(path))


def test_the_path_of_a_circle_is_printed_in_the_direction_of_the_values_with_the_fix() -> None:
    with pytest.raises(WiringError) as refused:
        plan(gains([(0, 2), (2, 1), (1, 0)], 3), cycles=REFUSED)
    assert refused.value.problem in {
        f"direct feed-through runs in a circle: {path}"
        for path in ("c0 -> c2 -> c1 -> c0", "c2 -> c1 -> c0 -> c2", "c1 -> c0 -> c2 -> c1")
    }
    assert (
        refused.value.fix
        == "set `cycles: {}` in `run` to iterate it, or `feed_through: none` for a component with dynamics"
    )


def test_a_component_that_drives_itself_is_a_circle() -> None:
    with pytest.raises(WiringError, match="circle: c0 -> c0"):
        plan(gains([(0, 0)], 1), cycles=REFUSED)


def test_a_circle_with_a_component_that_cannot_go_back_is_refused_even_when_iterating() -> None:
    wired = system([Gain("a", 0.5), Gain("b", 0.5, has_state=False)], ["a.y0 -> b.u0", "b.y0 -> a.u0"])
    with pytest.raises(WiringError, match=r"cannot be iterated: b cannot go back; its FMU needs canGetAndSetFMUstate"):
        plan(wired)


def test_a_chain_of_thousands_is_ordered() -> None:
    count = 3000
    wired = gains([(i + 1, i) for i in range(count - 1)], count)
    assert plan(wired).groups == tuple((name,) for name in reversed(names(count)))


def closed_loop(**more: object) -> System:
    plant = Plant("plant", -np.eye(1), np.eye(1), np.eye(1))
    return system([plant, Gain("controller", -1.0)], ["plant.y0 -> controller.u0", "controller.y0 -> plant.u0"], **more)  # type: ignore[arg-type]


def test_a_state_breaks_the_circle_and_the_controller_runs_first() -> None:
    made = plan(closed_loop(), cycles=REFUSED)
    assert made.groups == (("controller",), ("plant",))
    assert made.instant == {"plant": frozenset(), "controller": {"y0"}}


def test_jacobi_has_no_instant_outputs_and_thus_no_circles() -> None:
    made = plan(gains([(0, 1), (1, 0)], 2), Order.JACOBI, REFUSED)
    assert made.instant == {"c0": frozenset(), "c1": frozenset()}
    assert made.groups == (("c0",), ("c1",))


def test_feed_through_can_be_declared_away_or_added() -> None:
    wired = gains([(0, 1), (1, 0)], 2)
    tamed = System({**wired.parts, "c0": replace(wired.parts["c0"], feed_through="none")}, wired.connections)
    assert plan(tamed, cycles=REFUSED).groups == (("c1",), ("c0",))
    assert plan(closed_loop(feed_through={"plant": "all"})).groups == (("plant", "controller"),)


@pytest.mark.parametrize(
    ("direct", "instant"),
    [
        ({"y": ["u"], "z": ["u"]}, {"y", "z"}),
        ({"y": ["u"], "z": None}, {"y", "z"}),  # not declared: assume the worst
        ({"y": ["u"], "z": []}, set()),  # one state among the outputs: dynamics
        ({"y": [], "z": []}, set()),
    ],
)
def test_outputs_hold_at_once_only_where_all_react(direct: dict[str, list[str] | None], instant: set[str]) -> None:
    part = Part(interface(["u"], ["y", "z"], direct))
    assert part.instant_outputs() == instant
    assert replace(part, feed_through="none").instant_outputs() == frozenset()
    assert replace(part, feed_through="all").instant_outputs() == {"y", "z"}


def test_a_sampled_output_without_inputs_does_not_make_a_controller_slow() -> None:
    ports = interface(["u"], ["y", "count"], {"y": ["u"], "count": []})
    counting = replace(ports.ports["count"], variability="discrete")
    sampled = replace(ports, ports={**ports.ports, "count": counting})
    assert Part(sampled).instant_outputs() == {"y", "count"}


def multirate(*steps: str) -> System:
    parts = [Gain(name, 1.0) for name in names(len(steps))]
    return system(parts, steps={name: Fraction(step) for name, step in zip(names(len(steps)), steps, strict=True)})


def test_the_tick_is_the_common_divisor_of_all_steps() -> None:
    made = plan(multirate("1/50", "1/40"))
    assert made.tick == Fraction(1, 200)
    assert made.every == {"c0": 4, "c1": 5}


@pytest.mark.parametrize("step", ["0", "-1/10"])
def test_a_step_of_a_component_must_be_positive(step: str) -> None:
    with pytest.raises(WiringError, match=r"c0\.step: .* s is not positive"):
        plan(multirate(step))


def test_the_step_of_the_run_must_be_positive() -> None:
    with pytest.raises(WiringError, match="not positive"):
        make_plan(gains([], 1), Fraction(0), Order.JACOBI, ITERATE)


def fixed_step(own: float) -> System:
    part = Part(replace(Scripted("a", interface()).interface, fixed_step=own))
    return System({"a": part})


@pytest.mark.parametrize(("own", "nearest"), [(0.003, "0.009"), (0.1, "0.1"), (0.004, "0.008"), (1e9, "1e+09")])
def test_a_step_that_a_fixed_step_fmu_cannot_take_is_refused_with_the_nearest(own: float, nearest: str) -> None:
    with pytest.raises(WiringError) as refused:
        plan(fixed_step(own))
    assert str(refused.value) == f"a.step: 0.01 s is not a multiple of the FMU's own {own:g} s; use {nearest} s"


@pytest.mark.parametrize("own", [0.01, 0.001, 0.005, 1e-5, 1 / 300 * 3])
def test_multiples_of_a_fixed_step_are_accepted(own: float) -> None:
    assert plan(fixed_step(own)).every == {"a": 1}
