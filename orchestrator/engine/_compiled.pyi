"""What `compiled.py` uses of the extension."""

from enum import IntEnum

from numpy.typing import NDArray

from orchestrator.trace import FloatArray

Group = tuple[int, int, int, int, int | None, NDArray | None, float, float]

class Kind(IntEnum):
    FLOAT64 = 0
    FLOAT32 = 1
    INT8 = 2
    UINT8 = 3
    INT16 = 4
    UINT16 = 5
    INT32 = 6
    UINT32 = 7
    INT64 = 8
    UINT64 = 9
    FLAG = 10
    BOOL = 11

class Stage(IntEnum):
    RUNNING = 0
    MISFIT = 1
    WRITE = 2
    STEP = 3
    READ = 4

class Core:
    tick: int
    recorded: int
    base: int
    failing: int
    status: int
    stage: int

    def __init__(
        self,
        capacity: int,
        values: FloatArray,
        stimuli: tuple[FloatArray, int, int],
        clock: tuple[int, int, int],
        record_slots: NDArray,
        record_inputs: NDArray,
    ) -> None: ...
    def add(
        self,
        version: int,
        instance: int | None,
        step: int | None,
        flags: list[int] | None,
        every: int,
        duration: float,
        sources: NDArray,
        scale: FloatArray | None,
        held: int,
        first: int,
        instant: NDArray,
        staged: int,
        written: list[Group],
        read: list[Group],
    ) -> None: ...
    def run(self, last: int, budget: float, rows: FloatArray, record_every: int) -> None: ...
    def statistics(self, number: int) -> tuple[int, float, int]: ...
    def arrival(self, number: int) -> int | None: ...
