"""The contract between the engine and what it steps: FMUs here or in other processes, and scripted stand-ins.

What steps a system passes numbers on, and nothing else; for texts stand numbers, which `Texts` gives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from orchestrator.fmi.clocks.ticks import Arrival, Tick
from orchestrator.fmi.interface import Interface, Value


class Component(Protocol):
    """What the engine needs of a component; FMUs and scripted stand-ins alike.

    Life cycle: set*, begin, (write, read)*, run, (tune*, write, step, read)*, terminate, then reset or close.
    """

    name: str
    interface: Interface

    def set(self, values: Mapping[str, Value]) -> None:
        """Give parameters and start values; each is read back when the initialisation is over."""

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        """Enter initialisation; times in seconds, None where no end or relative tolerance is to be told."""

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Say which values `write` and `read` carry, in which order."""

    def write(self, values: Sequence[float]) -> None:
        """Set the bound inputs."""

    def read(self) -> Sequence[float]:
        """Values of the bound outputs, numbers that stand for texts among them."""

    @property
    def texts(self) -> Mapping[str, tuple[str, ...]]:
        """Variable -> the texts that its numbers stand for, from 0; of those that were read since the reset."""

    def run(self) -> None:
        """Leave initialisation."""

    def get(self, name: str) -> Value:
        """Present value of a variable, from the initialisation on."""

    def tune(self, name: str, value: Value) -> Value:
        """Give a tunable parameter, or an input that is not bound, a value between two steps, or a parameter one in the
        initialisation; what it has then."""

    def step(self, time: float, duration: float) -> None:
        """Advance from `time` by `duration` [s].

        Raises:
            FmuEnded: it asked to stop, at `time` or within this step.
        """

    def save(self) -> Any:
        """A snapshot of the whole state."""

    def restore(self, state: Any) -> None:
        """Go back to a snapshot."""

    def drop(self, state: Any) -> None:
        """Free a snapshot."""

    def terminate(self) -> None:
        """Say that the run is over; nothing where none is under way, or the FMU has failed. Trouble is only logged:
        what was computed is whole."""

    def reset(self) -> bool:
        """Back to where `begin` is allowed, all values at their defaults, also after an error that nothing comes back
        from; whether that moved its functions in memory."""

    def close(self) -> None:
        """Free everything."""


@runtime_checkable
class Ticking(Component, Protocol):
    """What the engine needs of a component with clocks, beyond the rest."""

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        """Have its clocks tick as others did, each at its time within the next steps."""

    def passed(self) -> Sequence[Tick]:
        """Ticks of its output clocks within the latest step."""


class Texts:
    """For each variable the texts that it has had since the beginning of a run, numbered from 0 as they came."""

    def __init__(self) -> None:
        self._numbers: dict[str, dict[str, int]] = {}

    def number(self, variable: str, text: str) -> float:
        """The number of a text."""
        known = self._numbers.setdefault(variable, {})
        return float(known.setdefault(text, len(known)))

    @property
    def known(self) -> Mapping[str, tuple[str, ...]]:
        """Variable -> its texts by their number."""
        return {variable: tuple(numbers) for variable, numbers in self._numbers.items()}

    def since(self, counts: dict[str, int]) -> list[tuple[str, str]]:
        """Variable and text of what is new since there were so many, which are counted up."""
        fresh = []
        for variable, numbers in self._numbers.items():
            if len(numbers) > (before := counts.get(variable, 0)):
                fresh += [(variable, text) for text in [*numbers][before:]]
                counts[variable] = len(numbers)
        return fresh

    def clear(self) -> None:
        """Begin anew."""
        self._numbers.clear()
