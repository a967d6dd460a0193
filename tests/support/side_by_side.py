"""Answers of many tasks from processes side by side, the project's own as its sweeps and suites use them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from orchestrator.processes.child import Died
from orchestrator.processes.pool import Processes

T = TypeVar("T")
A = TypeVar("A")


def side_by_side(make: Callable[[], Callable[[T], A]], tasks: Iterable[T], processes: int) -> list[A]:
    """The answers in the order of the tasks; `make` gives what answers them, in each process, here where it is one."""
    if processes == 1:
        return list(map(make(), tasks))
    found = dict[int, A]()
    with Processes(make, processes) as pool:
        for number, answer in pool.answers(tasks):
            assert not isinstance(answer, Died), answer
            found[number] = answer
    return [found[number] for number in sorted(found)]
