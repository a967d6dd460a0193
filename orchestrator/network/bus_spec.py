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
    """

    nodes: tuple[str, ...]
    bitrate: int | None = None
    data_bitrate: int | None = None
    direct: bool = False
    database: Path | None = None
