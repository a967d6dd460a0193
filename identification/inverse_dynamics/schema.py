"""The study file of an inverse-dynamics identification."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from identification.inverse_dynamics.loop import PositionLoop
from identification.inverse_dynamics.study import Axis, Filtering, InverseDynamicsStudy, Way
from identification.inverse_dynamics.terms import SAME, Term
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from orchestrator.assembly.schema import SystemBlock
from orchestrator.yaml_file import Block


class PositionBlock(Block):
    """The signal of the position, and the output that it is of.

    Attributes:
        signal: of the recordings.
        output: component.output that it is of.
    """

    signal: str
    output: str


class CommandBlock(Block):
    """The signal of the command, held from sample to sample, and the input that it is of.

    Attributes:
        signal: of the recordings.
        input: component.input that it drives.
        gain: component.parameter by which it is the force; without one it is the force itself.
    """

    signal: str
    input: str
    gain: str | None = Axis.gain


class PositionLoopBlock(Block):
    """The control that the axis was recorded in: command = speed_gain (position_gain (reference - position) - speed).

    Attributes:
        reference: signal.
        position_gain: [1/s].
        speed_gain: [command per speed].
    """

    reference: str
    position_gain: float = Field(gt=0)
    speed_gain: float = Field(gt=0)


class InverseDynamicsBlock(RecordedStudyBlock, SystemBlock):
    """A study that finds the parameters of an axis by linear regression of its force on its motion.

    Attributes:
        write: term of the inverse model -> component.parameter that takes its value.
        loop: with it there are instruments, and what noise does to least squares is avoided.
        take: least-squares or instrumental, whose values are written; instrumental where there is a loop.
        compare: name -> parameters of others, by component.parameter, beside those found.
        truth: values behind synthetic traces, shown beside the estimates.
    """

    explained_by = (Filtering,)

    method: Literal["inverse-dynamics"]
    position: PositionBlock
    command: CommandBlock
    cutoff: float = Field(gt=0)
    rows_per_second: float = Field(Filtering.rows_per_second, gt=0)
    least_speed: float = Field(Filtering.least_speed, ge=0)
    write: dict[Term, str]
    loop: PositionLoopBlock | None = None
    take: Way | None = None
    compare: dict[str, dict[str, float]] = {}
    truth: dict[str, float] = {}

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        reference = frozenset({self.loop.reference}) if self.loop else frozenset[str]()
        return UsedSignals(reference | {self.command.signal}, frozenset({self.position.signal}))

    @model_validator(mode="after")
    def _told_apart(self) -> InverseDynamicsBlock:
        if "inertia" not in self.write:
            raise ValueError("`write` lacks inertia, without which there is no force to explain")
        for same in SAME:
            if same <= set(self.write):
                raise ValueError(f"`write`: no motion tells {', '.join(sorted(same))} apart; remove one")
        if self.take == "instrumental" and self.loop is None:
            raise ValueError("`take: instrumental` needs the `loop` that the axis was recorded in")
        if self.traces.values:
            raise ValueError("`traces.values` mean nothing here; remove them")
        for name in [name for values in (*self.compare.values(), self.truth) for name in values]:
            if name not in self.write.values():
                raise ValueError(f"`compare` and `truth`: {name} is not written")
        return self

    def study(self, base: Path) -> InverseDynamicsStudy:
        """The study as plain values; `base` is the folder of its file."""
        position, command, loop = self.position, self.command, self.loop
        return InverseDynamicsStudy(
            title=self.title,
            system=self.system(base),
            traces=self.source(base),
            axis=Axis(position.signal, position.output, command.signal, command.input, command.gain),
            filtering=Filtering(self.cutoff, self.rows_per_second, self.least_speed),
            write=self.write,
            take=self.take or ("instrumental" if loop else "least-squares"),
            loop=PositionLoop(loop.reference, loop.position_gain, loop.speed_gain) if loop else None,
            description=self.description,
            compare=self.compare,
            truth=self.truth,
        )
