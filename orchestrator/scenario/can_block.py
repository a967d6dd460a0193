"""A scenario's `can` block: which inputs take signals of a bus, and which outputs are sent as signals.

Only what the file says: a plain run, which never sees a bus, checks it and takes the safe values. What becomes of it on
a bus is the bridge's.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator, model_validator

from orchestrator.assembly.schema import exact_seconds
from orchestrator.yaml_file import Block


class ReceivedBlock(Block):
    """Where an input takes its value from.

    Attributes:
        signal: of the database, as `Message.signal`, or its own name where that is unique.
        safe: value of the input before the first frame and while none comes [unit of the input].
        silence: how long no frame may come until the safe value is taken, the block's by default [s].
    """

    signal: str
    safe: float
    silence: float | None = Field(None, gt=0)


class SentBlock(Block):
    """Where a signal takes its value from.

    Attributes:
        source: component.output.
        safe: value that is sent when the coupling ends, however it does [unit of the output].
    """

    source: str
    safe: float | None = None


class CanBlock(Block):
    """How a scenario is coupled to a CAN bus.

    Attributes:
        database: a DBC, or another file that describes messages.
        receive: component.input -> where its value comes from.
        send: signal -> where its value comes from.
        every: message -> its period over that of the database [s].
        silence: how long no frame of a received message may come until its inputs take their safe values [s].
    """

    database: Path
    receive: dict[str, ReceivedBlock] = {}
    send: dict[str, SentBlock] = {}
    every: dict[str, Fraction] = {}
    silence: float = Field(0.1, gt=0)

    @field_validator("send", mode="before")
    @classmethod
    def _plain_sources(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {signal: {"source": source} if isinstance(source, str) else source for signal, source in value.items()}

    @field_validator("every", mode="before")
    @classmethod
    def _exact(cls, value: Any) -> Any:
        return (
            {message: exact_seconds(period) for message, period in value.items()} if isinstance(value, dict) else value
        )

    @model_validator(mode="after")
    def _something(self) -> CanBlock:
        if not self.receive and not self.send:
            raise ValueError("give `receive`, `send` or both")
        if any(period <= 0 for period in self.every.values()):
            raise ValueError("a period in `every` must be positive")
        return self
