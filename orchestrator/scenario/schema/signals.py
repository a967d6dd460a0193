"""What drives the inputs of a scenario, and what samples it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, Field, model_validator

from orchestrator.assembly.schema import SignalFileBlock
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.formats.schema import LayoutBlock
from orchestrator.scenario.scenario import DataLogger
from orchestrator.yaml_file import Block, Quantity, may_be_partial


class StimulusBlock(Block):
    """What drives an input: a constant, or a signal of a trace file.

    Attributes:
        constant: in the unit of the input, or with its own: `90 deg`.
        file: a recording, relative to this file; instead of `constant`.
        signal: its name in the recording.
        factor, offset: input = factor * signal + offset, over what their units say.
        interpolation: between samples; by default `hold` where the input is no real number or discrete, else `linear`.
        ends: what holds before the file begins and after it ends: nothing, or its first and its last value.
        layout: how the file is laid out, where it does not tell.
    """

    constant: float | Quantity | None = None
    file: Path | None = None
    signal: str | None = None
    factor: float | None = None
    offset: float | None = None
    interpolation: Literal["hold", "linear"] | None = None
    ends: Literal["refuse", "hold"] = "refuse"
    layout: LayoutBlock = LayoutBlock()

    @model_validator(mode="after")
    def _one_kind(self) -> StimulusBlock:
        if (self.constant is None) == (self.file is None) or (self.file is None) != (self.signal is None):
            raise ValueError("give `constant`, or `file` and `signal`")
        if self.constant is not None and self.ends == "hold":
            raise ValueError("`ends` goes with `file`; a constant has none")
        if self.constant is not None and (self.factor is not None or self.offset is not None):
            raise ValueError("`factor` and `offset` go with `file`; write `constant: 90 deg`")
        return self

    def stimulus(self, base: Path, said: list[str] | None = None) -> Stimulus:
        """The stimulus; its file is relative to `base`, and what is to be known of it is added to `said`."""
        if self.constant is not None:
            return Stimulus(self.constant)
        assert self.file is not None and self.signal is not None
        recording = SignalFileBlock(
            file=self.file, signal=self.signal, factor=self.factor, offset=self.offset, layout=self.layout
        )
        hold = None if self.interpolation is None else self.interpolation == "hold"
        return Stimulus(
            recording.trace(base, said),
            hold,
            recording.given,
            self.ends == "hold",
            base / self.file,
        )


class DataLoggerBlock(Block):
    """A data logger that samples the run; see `DataLogger`."""

    explained_by = (DataLogger,)

    model_config = ConfigDict(json_schema_extra=may_be_partial)

    signals: dict[str, str] = Field(min_length=1)
    every: float = Field(gt=0)
    jitter: float = Field(DataLogger.jitter, ge=0, lt=1)
    first: float | None = Field(DataLogger.first, ge=0)
    seed: int = DataLogger.seed
