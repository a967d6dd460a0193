"""What of a system a change at a variable can reach: components, along the connections."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from orchestrator.scenario.expectations import Expected
from orchestrator.scenario.scenario import Case
from orchestrator.system import System


def reached(system: System, component: str) -> set[str]:
    """The component and all that its outputs come to."""
    found, left = set[str](), [component]
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += [link.target.component for link in system.links if link.source.component == one]
    return found


def unseen(system: System, names: Iterable[str], signals: Collection[str], cases: Iterable[Case]) -> list[str]:
    """Of the names, component or component.variable, those that come to none of the signals, and that no expectation
    of a case can notice."""
    whole_run = any(not _looks(leaf) for case in cases for one in case.expected for leaf in one.leaves)
    seen = {signal.partition(".")[0] for signal in signals}
    return [] if whole_run else [name for name in names if not reached(system, name.partition(".")[0]) & seen]


def _looks(expected: Expected) -> bool:
    """Whether an expectation looks at signals, and not at the run as a whole."""
    return bool(expected.signals)
