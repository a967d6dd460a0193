"""What a run spent its time on, event by event, as viewers of traces show it (Perfetto, chrome://tracing).

Components are watched from outside: each step, with the values written before it and read after it, is an event on the
track of its component. The compiled loop has no place to look from, so a watched run is stepped by the one in Python.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Any, NamedTuple, NotRequired, TypedDict

from orchestrator.fmi.clocks.ticks import Arrival, Tick
from orchestrator.fmi.component import Component, Ticking
from orchestrator.fmi.interface import Value
from orchestrator.trace import Trace

MOST = 200_000  # events of steps that are kept, some 20 MB as a file
RUN = "run"  # the track of what is no component's


class ProfileEvent(NamedTuple):
    """What happened on a track, from when and how long [ns], and up to which time of the simulation [s]."""

    track: str
    name: str
    begun: int
    spent: int
    until: float | None = None


class EventDocument(TypedDict):
    """An event in the format of Chrome's traces; times in µs."""

    ph: str
    name: str
    pid: int
    cat: NotRequired[str]
    tid: NotRequired[int]
    ts: NotRequired[float]
    dur: NotRequired[float]
    args: NotRequired[dict[str, str | float]]


class ProfileDocument(TypedDict):
    """Events in the format of Chrome's traces."""

    traceEvents: list[EventDocument]
    displayTimeUnit: str
    otherData: dict[str, int]


@dataclass
class RunProfile:
    """Events in the order in which they ended; of steps the first `MOST`.

    Attributes:
        left_out: steps that came after them.
    """

    events: list[ProfileEvent] = field(default_factory=list)
    left_out: int = 0
    _steps: int = 0

    @contextmanager
    def span(self, name: str) -> Iterator[None]:
        """Have the block be an event of the run."""
        begun = perf_counter_ns()
        try:
            yield
        finally:
            self.events.append(ProfileEvent(RUN, name, begun, perf_counter_ns() - begun))

    def step(self, track: str, begun: int, until: float) -> None:
        """Take note of a step that ends now."""
        self._steps += 1
        if self._steps > MOST:
            self.left_out += 1
        else:
            self.events.append(ProfileEvent(track, "step", begun, perf_counter_ns() - begun, until))

    def document(self) -> ProfileDocument:
        """The events in the format of Chrome's traces; times in µs from the first one on."""
        first = min((event.begun for event in self.events), default=0)
        tracks = dict.fromkeys([RUN, *(event.track for event in self.events)])
        numbers = {track: number for number, track in enumerate(tracks, 1)}
        told: list[EventDocument] = [
            {"ph": "M", "name": "thread_name", "pid": 1, "tid": number, "args": {"name": track}}
            for track, number in numbers.items()
        ]
        told.append({"ph": "M", "name": "process_name", "pid": 1, "args": {"name": "servotwin"}})
        told += [_told(event, numbers[event.track], first) for event in self.events]
        return {"traceEvents": told, "displayTimeUnit": "ns", "otherData": {"steps left out": self.left_out}}


def _told(event: ProfileEvent, number: int, first: int) -> EventDocument:
    told: EventDocument = {
        "ph": "X",
        "name": event.name,
        "cat": "run" if event.until is None else "step",
        "pid": 1,
        "tid": number,
        "ts": (event.begun - first) / 1000,
        "dur": event.spent / 1000,
    }
    return told if event.until is None else told | {"args": {"until [s]": event.until}}


class Watched:
    """A component whose steps go to a profile: from the inputs that it is given to the outputs that are read."""

    def __init__(self, component: Component, profile: RunProfile) -> None:
        self._component, self._profile = component, profile
        self.name, self.interface = component.name, component.interface
        self._begun = 0
        self._until: float | None = None

    @property
    def warnings(self) -> int:
        """Number of warnings its FMU returned."""
        return getattr(self._component, "warnings", 0)

    def write(self, values: Sequence[float]) -> None:
        self._begun = perf_counter_ns()
        self._component.write(values)

    def step(self, time: float, duration: float) -> None:
        self._begun = self._begun or perf_counter_ns()
        self._component.step(time, duration)
        self._until = time + duration

    def read(self) -> Sequence[float]:
        values = self._component.read()
        if self._until is not None:
            self._profile.step(self.name, self._begun, self._until)
        self._begun, self._until = 0, None
        return values

    @property
    def texts(self) -> Mapping[str, tuple[str, ...]]:
        return self._component.texts

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        if isinstance(self._component, Ticking):
            self._component.expect(arrivals)

    def passed(self) -> Sequence[Tick]:
        return self._component.passed() if isinstance(self._component, Ticking) else ()

    @property
    def intermediate(self) -> Trace | None:
        """What it gave within its steps, where that is kept."""
        return getattr(self._component, "intermediate", None)

    def get(self, name: str) -> Value:
        return self._component.get(name)

    def tune(self, name: str, value: Value) -> Value:
        return self._component.tune(name, value)

    def set(self, values: Mapping[str, Value]) -> None:
        self._component.set(values)

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._component.begin(start, stop, tolerance)

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._component.bind(inputs, outputs)

    def run(self) -> None:
        self._component.run()

    def save(self) -> Any:
        return self._component.save()

    def restore(self, state: Any) -> None:
        self._component.restore(state)

    def drop(self, state: Any) -> None:
        self._component.drop(state)

    def terminate(self) -> None:
        self._component.terminate()

    def reset(self) -> bool:
        return self._component.reset()

    def close(self) -> None:
        self._component.close()
