"""What a bus of a system is, in plain values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class BusSpec:
    """A CAN bus between components.

    Attributes:
        nodes: those on it, as component.Terminal.
        bitrate, data_bitrate: None: what the nodes configure [bit/s].
        direct: whether it is a wire between two, which arbitrates and delays nothing, as to an FMU that is the bus.
        database: of nodes that exchange signals instead of frames, and of what others may put on the bus.
        most_late: by how much a step may be late until nothing passes to and from a real bus that it is coupled to, by
            default 3 steps and 0.05 s at least [s].
        give_up: by how much until the coupling ends; twice as long may no step end [s].
    """

    nodes: tuple[str, ...]
    bitrate: int | None = None
    data_bitrate: int | None = None
    direct: bool = False
    database: Path | None = None
    most_late: float | None = None
    give_up: float = 2.0
