"""A scenario's `can` block: which inputs take signals of a bus, and which outputs are sent as signals.

Only what the file says: a plain run, which never sees a bus, checks it and takes the safe values. What becomes of it on
a bus is the bridge's.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from orchestrator.yaml_file import Block, Quantity, Seconds, Time


class ReceivedBlock(Block):
    """Where an input takes its value from.

    Attributes:
        signal: of the database, as `Message.signal`, or its own name where that is unique.
        safe: value of the input before the first good value and while none comes [unit of the input, or its own].
        silence: how long none may come until the safe value is taken, the block's by default [s].
        range: whether values outside the range of the signal or of the input are limited to it, or are no good values.
        channel: number of its bus over that of its message.
    """

    signal: str
    safe: float | Quantity
    silence: Annotated[Time, Field(gt=0)] | None = None
    range: Literal["limit", "reject"] = "limit"
    channel: int | None = Field(None, ge=0)


class LimitBlock(Block):
    """How far and how fast a sent value may go.

    Attributes:
        rate: largest change [unit of the output per s]; from a safe value on, too, but not to it.
        magnitude: largest amount [unit of the output, or its own].
    """

    rate: float | None = Field(None, gt=0)
    magnitude: Annotated[float, Field(ge=0)] | Quantity | None = None


class SentBlock(Block):
    """Where a signal takes its value from.

    Attributes:
        source: component.output.
        safe: value that is sent while the output rests, and at the end, however it comes [as in `ReceivedBlock`].
        while_: messages, signals or inputs without which it rests; by default all received ones that it may depend on.
        channel: number of its bus over that of its message.
    """

    source: str
    safe: float | Quantity | None = None
    while_: list[str] | None = Field(None, alias="while")
    limit: LimitBlock = LimitBlock()
    channel: int | None = Field(None, ge=0)

    @model_validator(mode="after")
    def _guarded(self) -> SentBlock:
        if self.while_ is not None and self.safe is None:
            raise ValueError("`while` says when the output rests: give `safe`, too")
        return self


def _source(value: Any) -> Any:
    return {"source": value} if isinstance(value, str) else value


Sent = Annotated[SentBlock, BeforeValidator(_source, json_schema_input_type=SentBlock | str)]


class CanBlock(Block):
    """How a scenario is coupled to a CAN bus.

    Attributes:
        database: a DBC, or other files that describe messages; or those of each channel by its number, and of `all`.
        channel: message -> number of its bus, from 0 in the order of --channel; else the first whose database has it.
        encoding: of their text; None guesses.
        receive: component.input -> where its value comes from.
        send: signal -> where its value comes from.
        every: message -> its period over that of the database [s].
        silence: how long no good value of a received signal may come until its input takes its safe value [s].
        resume: whether an output that has come to rest goes on by itself, `after` some time of good values.
        after: how long values have to be good until then, and good ones of what was silent have to come [s].
        on_silence: whether outputs rest, or the coupling ends, when a received signal falls silent.
        most_late: by how much a step may be late until all outputs rest, by default 3 steps and 0.05 s at least [s].
        give_up: by how much until the coupling ends [s].
        reconnect: whether a bridge opens a lost bus again, every second, instead of ending.
        stop: signal of the bus that ends the coupling when it is not zero; outputs rest while it is silent.
    """

    database: Path | list[Path] | dict[Annotated[int, Field(ge=0)] | Literal["all"], Path | list[Path]]
    channel: dict[str, Annotated[int, Field(ge=0)]] = {}
    encoding: str | None = None
    receive: dict[str, ReceivedBlock] = {}
    send: dict[str, Sent] = {}
    every: dict[str, Seconds] = {}
    silence: Time = Field(0.1, gt=0)
    resume: Literal["auto", "latch"] = "auto"
    after: Time = Field(0.1, ge=0)
    on_silence: Literal["rest", "end"] = "rest"
    most_late: Annotated[Time, Field(gt=0)] | None = None
    give_up: Time = Field(2.0, gt=0)
    reconnect: bool = False
    stop: str | None = None

    @model_validator(mode="after")
    def _something(self) -> CanBlock:
        if not self.receive and not self.send:
            raise ValueError("give `receive`, `send` or both")
        if any(period <= 0 for period in self.every.values()):
            raise ValueError("a period in `every` must be positive")
        return self
