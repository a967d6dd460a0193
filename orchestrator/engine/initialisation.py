"""How the components of a run are initialised, with values that are settled along all connections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction

from fmus.errors import FmuError
from orchestrator.engine.loop import Loop, Stepper
from orchestrator.engine.planning.plan import CycleSettings
from orchestrator.engine.run import Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value
from orchestrator.settable import check_value
from orchestrator.system import System


def initialise(
    system: System,
    components: Mapping[str, Component],
    timing: Timing,
    engine: Stepper,
    loop: Loop,
    own: Mapping[str, Mapping[str, Value]],
    stop: Fraction | None,
) -> None:
    """Initialise the components of a system, with their own values, for a run until `stop` [s]."""
    told = None if stop is None or not timing.tell_stop else float(stop)
    for name, component in components.items():
        component.set(own[name])
    for component in components.values():
        component.begin(float(timing.start), told, timing.tolerance)
    _settle(system, components)
    _propagate(engine, loop, timing.cycles)
    for component in components.values():
        component.run()
    values = engine.pass_on(writing=False)
    for node in loop.nodes if not math.isfinite(sum(values)) else ():
        loop.require_finite(node, values[node.first : node.first + len(node.outputs)], "initialisation")


def _settle(system: System, components: Mapping[str, Component]) -> None:
    """Give parameters the values that others calculate, until nothing changes: what is calculated may depend on them.

    Raises:
        WiringError: a value does not fit its parameter.
        FmuError: an FMU does not take it, or they do not settle.
    """
    given: dict[str, Value] = {}
    for _ in range(len(system.settled) + 1):
        before = dict(given)
        for link in system.settled:
            name, port = str(link.target), system.port(link.target)
            value = components[link.source.component].get(link.source.variable)
            if (link.factor, link.offset) != (1.0, 0.0):
                value = link.factor * float(value) + link.offset
            given[name] = check_value(name, port, value)
            if given[name] != before.get(name):
                _give(components[link.target.component], link.target.variable, given[name])
        if given == before:
            return
    names = ", ".join(given)
    raise FmuError(names, "the calculated parameters that they are given run in a circle", "remove a connection")


def _give(component: Component, name: str, value: Value) -> None:
    """Give a parameter a value, and see that it has it, but for rounding to single precision."""
    taken = component.tune(name, value)
    if taken != value and not math.isclose(float(taken), float(value), rel_tol=1e-6):
        fix = "its FMU does not take it in the initialisation; remove the connection, or ask the supplier"
        raise FmuError(f"{component.name}.{name}", f"was set to {value} but is {taken}", fix)


def _propagate(engine: Stepper, loop: Loop, cycles: CycleSettings) -> None:
    """Pass outputs to inputs during initialisation until nothing changes.

    A chain of n components is through after n passes; a circle of direct feed-through may need more.
    """
    nodes, before = loop.nodes, engine.pass_on(writing=True)
    for turn in range(1, len(nodes) + 1 + cycles.limit):
        after = engine.pass_on(writing=True)
        moving = _moving(before, after, cycles.tolerance if turn > len(nodes) else 0.0)
        if not moving:
            return
        before = after
    names = [n.component.name for n in nodes if any(0 <= slot - n.first < len(n.instant) for slot in moving)]
    raise FmuError(
        ", ".join(names),
        f"the initial values run in a circle and do not settle in {turn + 1} passes",
        "break the circle, or give start values that fit",
    )


def _moving(before: Sequence[float], after: Sequence[float], tolerance: float) -> list[int]:
    """Slots whose value changed by more than the tolerance, relative to 1 + |value|; NaN counts as no change."""
    if before == after:
        return []
    return [
        slot
        for slot, (then, now) in enumerate(zip(before, after, strict=True))
        if now != then and abs(now - then) > tolerance * (1.0 + abs(now))
    ]
