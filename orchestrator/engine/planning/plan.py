"""In which order and at which ticks the components of a system are stepped.

Gauss-Seidel: a component whose outputs react at once runs before those that use them, so nothing is delayed that is
not delayed in reality; outputs that are states of dynamics are passed on as they were at the beginning of the step.
Jacobi: every output is passed on as it was at the beginning of the step. Iterated: see `orchestrator.engine.iterated`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter

from fmus.errors import WiringError
from orchestrator.rational import common_divisor, multiples, written
from orchestrator.system import Connection, Part, System, TextLink


class Order(StrEnum):
    """How outputs travel within a communication step."""

    GAUSS_SEIDEL = "gauss-seidel"
    JACOBI = "jacobi"
    ITERATED = "iterated"


@dataclass(frozen=True)
class CycleSettings:
    """What to do with cycles of direct feed-through: refuse them, or iterate each step to a fixed point.

    Attributes:
        iterate: iterate instead of refusing.
        tolerance: largest change of a value between iterations, relative to 1 + |value|.
        limit: iterations before the run fails.
    """

    iterate: bool = True
    tolerance: float = 1e-10
    limit: int = 50


REFUSED = CycleSettings(iterate=False)


@dataclass(frozen=True)
class Plan:
    """Ticks and order of a run.

    Attributes:
        tick: greatest common divisor of all communication steps [s].
        every: component -> its communication step in ticks.
        groups: components in stepping order; those of one cycle share a group.
        instant: component -> outputs that are passed on within the step.
        iterated: whether steps are repeated until what they take over them agrees with what they give.
    """

    tick: Fraction
    every: Mapping[str, int]
    groups: tuple[tuple[str, ...], ...]
    instant: Mapping[str, frozenset[str]]
    iterated: bool = False


def make_plan(system: System, step: Fraction, order: Order, cycles: CycleSettings) -> Plan:
    """The plan of a system whose components step by `step` [s] unless they have their own.

    Raises:
        WiringError: a step that is not positive or that a fixed-step FMU does not allow, or a cycle of direct
            feed-through that is not to be iterated or cannot be (the message prints its path).
    """
    steps = {name: step if part.step is None else part.step for name, part in system.parts.items()}
    for name, part in system.parts.items():
        if part.carries:
            steps[name] = common_divisor([steps[other] for other in part.carries])
    for name, own in steps.items():
        if own <= 0:
            raise WiringError(f"{name}.step", f"{written(own)} s is not positive", "give a step")
        _fits_fixed_step(name, system.parts[name], own)
    tick = common_divisor([*steps.values(), step])
    jacobi, iterated = order is Order.JACOBI, order is Order.ITERATED
    if iterated:
        _check_iterated(system, steps, step)
    instant = {name: frozenset() if jacobi else part.instant_outputs() for name, part in system.parts.items()}
    before = _predecessors(system, instant)
    groups = _groups(before)
    _check_clocks(system, jacobi, groups, steps)
    _check_texts(system, groups)
    for group in groups:
        if (len(group) > 1 or group[0] in before[group[0]]) and not iterated:
            _allow_cycle(system, group, before, cycles)
    every = {name: multiples(own, tick, f"{name}.step") for name, own in steps.items()}
    return Plan(tick, every, groups, instant, iterated)


def _fits_fixed_step(name: str, part: Part, step: Fraction) -> None:
    fixed = part.interface.fixed_step
    if not fixed:
        return
    count = round(float(step) / fixed)
    if count < 1 or abs(float(step) / fixed - count) > 1e-9:
        raise WiringError(
            f"{name}.step",
            f"{written(step)} s is not a multiple of the FMU's own {fixed:g} s",
            f"use {max(1, count) * fixed:.9g} s",
        )


def _groups(before: Mapping[str, list[str]]) -> tuple[tuple[str, ...], ...]:
    """Strongly connected components of "must run before", in running order: circles are joined until none is left."""
    group = {name: (name,) for name in before}
    while True:
        needs: dict[tuple[str, ...], dict[tuple[str, ...], None]] = {}  # inner ones as ordered sets
        for name, others in before.items():
            needs.setdefault(group[name], {}).update(
                {group[other]: None for other in others if group[other] != group[name]}
            )
        try:
            return tuple(TopologicalSorter(needs).static_order())
        except CycleError as error:
            members = {name for joined in error.args[1] for name in joined}
            group |= dict.fromkeys(members, tuple(name for name in before if name in members))


def _predecessors(system: System, instant: Mapping[str, frozenset[str]]) -> dict[str, list[str]]:
    before: dict[str, list[str]] = {name: [] for name in system.parts}
    valued: tuple[Connection | TextLink, ...] = (*system.connections, *system.texts)
    for link in valued:
        if link.source.variable in instant[link.source.component]:
            before[link.target.component].append(link.source.component)
    for tick in system.clocks:
        before[tick.target.component].append(tick.source.component)
    for name, part in system.parts.items():
        before[name] += part.carries
    return before


def _check_clocks(
    system: System, jacobi: bool, groups: Sequence[tuple[str, ...]], steps: Mapping[str, Fraction]
) -> None:
    """See that every tick comes in time to who it is for."""
    for link in system.clocks:
        one, other = link.source.component, link.target.component
        if jacobi:
            raise WiringError(
                str(link), "would tick a step late, as `order: jacobi` steps all at once", "remove `order`"
            )
        if any(one in group and other in group for group in groups):
            problem = f"is on a circle: {other} acts on {one} within the step in which {one} ticks it"
            raise WiringError(str(link), problem, "set `feed_through: none` for a component with dynamics")
        if (steps[one] / steps[other]).denominator != 1:
            problem = (
                f"{other} steps by {written(steps[other])} s, ahead of {one}, which steps by {written(steps[one])} s"
            )
            raise WiringError(str(link), problem, f"give {other} a `step` of which that is a multiple")


def _check_texts(system: System, groups: Sequence[tuple[str, ...]]) -> None:
    """See that no text runs in a circle that is iterated."""
    for link in system.texts:
        if any(len(group) > 1 and {link.source.component, link.target.component} <= {*group} for group in groups):
            fix = "set `feed_through: none` for a component with dynamics"
            raise WiringError(str(link), "is on a circle of direct feed-through, and texts are not iterated", fix)


def _check_iterated(system: System, steps: Mapping[str, Fraction], step: Fraction) -> None:
    """See that all components can take a step of the run's length, and take it back."""
    if carrying := next((name for name, part in system.parts.items() if part.carries), None):
        problem = "carries frames, which are not taken back, and iterated steps are"
        raise WiringError(carrying, problem, "remove `order: iterated`")
    for name, part in system.parts.items():
        if steps[name] != step:
            problem = f"is {written(steps[name])} s, and iterated steps are those of all, {written(step)} s"
            raise WiringError(f"{name}.step", problem, "remove it, or remove `order`")
        if not part.interface.has_state:
            fix = "its FMU needs canGetAndSetFMUstate; or remove `order`"
            raise WiringError(name, "cannot go back, and iterated steps are taken back", fix)
    for link in system.clocks:
        raise WiringError(str(link), "would tick in steps that are taken back", "remove `order: iterated`")
    for text in system.texts:
        raise WiringError(str(text), "has no mean over a step, and is not iterated", "remove `order: iterated`")


def _allow_cycle(
    system: System, group: tuple[str, ...], before: Mapping[str, list[str]], cycles: CycleSettings
) -> None:
    path = _cycle_path(group, before)
    if not cycles.iterate:
        raise WiringError(
            "connections",
            f"direct feed-through runs in a circle: {path}",
            "set `cycles: {}` in `run` to iterate it, or `feed_through: none` for a component with dynamics",
        )
    stateless = [name for name in group if not system.parts[name].interface.has_state]
    if stateless:
        raise WiringError(
            "connections",
            f"the circle {path} cannot be iterated: {stateless[0]} cannot go back",
            "its FMU needs canGetAndSetFMUstate; or set `feed_through: none`",
        )


def _cycle_path(group: tuple[str, ...], before: Mapping[str, list[str]]) -> str:
    """One circle among the members, in the direction in which values flow."""
    try:
        TopologicalSorter({name: [other for other in before[name] if other in group] for name in group}).prepare()
    except CycleError as error:
        return " -> ".join(error.args[1])
    return " -> ".join(group)
