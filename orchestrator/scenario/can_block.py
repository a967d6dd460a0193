"""A scenario's `can` block: which inputs take signals of a bus, and which outputs are sent as signals.

Only what the file says: a plain run, which never sees a bus, checks it and takes the safe values. What becomes of it on
a bus is the bridge's.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from orchestrator.yaml_file import Block, Seconds


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


def _source(value: Any) -> Any:
    return {"source": value} if isinstance(value, str) else value


Sent = Annotated[SentBlock, BeforeValidator(_source, json_schema_input_type=SentBlock | str)]


class CanBlock(Block):
    """How a scenario is coupled to a CAN bus.

    Attributes:
        database: a DBC, or other files that describe messages.
        encoding: of their text; None guesses.
        receive: component.input -> where its value comes from.
        send: signal -> where its value comes from.
        every: message -> its period over that of the database [s].
        silence: how long no frame of a received message may come until its inputs take their safe values [s].
    """

    database: Path | list[Path]
    encoding: str | None = None
    receive: dict[str, ReceivedBlock] = {}
    send: dict[str, Sent] = {}
    every: dict[str, Seconds] = {}
    silence: float = Field(0.1, gt=0)

    @model_validator(mode="after")
    def _something(self) -> CanBlock:
        if not self.receive and not self.send:
            raise ValueError("give `receive`, `send` or both")
        if any(period <= 0 for period in self.every.values()):
            raise ValueError("a period in `every` must be positive")
        return self
