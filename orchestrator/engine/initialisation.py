"""How the components of a run are initialised, with values that are settled along all connections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction

from fmus.errors import FmuError
from orchestrator.engine.loop import Loop, Stepper
from orchestrator.engine.plan import CycleSettings
from orchestrator.engine.run import Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value


def initialise(
    components: Mapping[str, Component],
    timing: Timing,
    engine: Stepper,
    loop: Loop,
    own: Mapping[str, Mapping[str, Value]],
    stop: Fraction | None,
) -> None:
    """Initialise the components, with their own values, for a run until `stop` [s]."""
    told = None if stop is None or not timing.tell_stop else float(stop)
    for name, component in components.items():
        component.set(own[name])
    for component in components.values():
        component.begin(float(timing.start), told, timing.tolerance)
    _propagate(engine, loop, timing.cycles)
    for component in components.values():
        component.run()
    values = engine.pass_on(writing=False)
    for node in loop.nodes if not math.isfinite(sum(values)) else ():
        loop.require_finite(node, values[node.first : node.first + len(node.outputs)], "initialisation")


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
