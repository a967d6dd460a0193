"""What `compiled.py` uses of the extension."""

from enum import IntEnum
from typing import Any

from orchestrator.fmi.clocks.schedule import Timed
from orchestrator.trace import FloatArray

Row = tuple[int, ...]

class Storage(IntEnum):
    FLOAT64 = 0
    INT32 = 1
    FLAG = 2
    FLOAT32 = 3
    BOOL = 4
    INT8 = 5
    UINT8 = 6
    INT16 = 7
    UINT16 = 8
    UINT32 = 9
    INT64 = 10
    UINT64 = 11

class Stage(IntEnum):
    RUNNING = 0
    MISFIT = 1
    WRITE = 2
    STEP = 3
    READ = 4
    VALUE = 5
    ENTER = 6
    TICK = 7
    UPDATE = 8
    LEAVE = 9
    ENDING = 10
    TURNS = 11
    EVENTS = 12
    STUCK = 13
    FLOODED = 14
    TICKING = 15
    INTERVALS = 16
    INTERVAL = 17
    ASKED = 18

class Interval(IntEnum):
    STEADY = 0
    TUNABLE = 1
    CHANGING = 2
    COUNTDOWN = 3

class Core:
    tick: int
    recorded: int
    base: int
    failing: int
    status: int
    stage: int
    at: float
    span: float
    ticking: int
    part: int
    clock: int
    interval: float

    def __init__(
        self,
        capacity: int,
        targets: list[int],
        hold: int,
        clock: tuple[int, int, int],
        record_outputs: list[int],
        record_inputs: list[int],
        finite: bool,
    ) -> None: ...
    def add_rate(self, every: int, deferred: list[Row]) -> None: ...
    def add_node(
        self,
        rate: int,
        version: int,
        instance: int,
        step: int,
        flags: list[int],
        reached: int,
        asking: list[int],
        duration: float,
        sources: list[int],
        scale: FloatArray | None,
        held: list[int],
        packed: list[Row],
        writing: list[Row],
        reading: list[Row],
        instant: list[Row],
        late: list[Row],
    ) -> None: ...
    def add_event(
        self,
        number: int,
        functions: list[int],
        references: list[int],
        timed: list[tuple[int, int, Timed]],
        outputs: list[int],
        parts: list[tuple[Any, ...]],
        given: int,
    ) -> None: ...
    def add_routes(self, routes: list[tuple[int, int, list[int], list[tuple[Any, ...]]]]) -> None: ...
    def expect(self, number: int, time: float, clocks: int, values: list[float]) -> None: ...
    def load(self, number: int, next_event: float, due: bool, in_event: bool, before: list[float]) -> None: ...
    def unload(self, number: int) -> tuple[float, bool, bool]: ...
    def begin(self, stimuli: FloatArray) -> None: ...
    def pass_on(self, writing: bool) -> bool: ...
    def run(self, last: int, budget: float, rows: FloatArray, record_every: int) -> None: ...
    def statistics(self, number: int) -> tuple[int, float, int]: ...
