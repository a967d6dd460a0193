"""The study file of a recalibration near a motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from identification.motion.balance import Lumped
from identification.motion.study import MotionSignals, MotionStudy, TubeSpec, Way
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from orchestrator.assembly.schema import SystemBlock
from orchestrator.yaml_file import Block, Seconds

DRY: tuple[Lumped, ...] = ("dry_positive", "dry_negative")


class AngleBlock(Block):
    """The signal of the angle, the output that it is of, and the parameter that free runs take its start value by.

    Attributes:
        signal: of the traces.
        output: component.output that it is of.
        start: component.parameter that sets where free runs begin.
    """

    signal: str
    output: str
    start: str


class SpeedBlock(Block):
    """The signal of the speed, where there is one, and the parameter that free runs take its start value by.

    Attributes:
        signal: of the traces; without, the angle's derivative is taken.
        start: component.parameter that sets the speed that free runs begin with.
    """

    signal: str | None = None
    start: str


class VoltageBlock(Block):
    """The signal of the command, and the input that it drives in free runs.

    Attributes:
        signal: of the traces.
        input: component.input that it drives.
    """

    signal: str
    input: str


class FreeRunsBlock(Block):
    """Free runs in the tube around the motion, by which the generic and the recalibrated model are compared."""

    explained_by = (TubeSpec,)

    periods: float = Field(TubeSpec.periods, gt=0)
    skip: Seconds = TubeSpec.skip
    at_least: float | None = Field(TubeSpec.at_least, gt=0)


def _names(value: object) -> object:
    return [value] if isinstance(value, str) else value


Names = Annotated[list[str], BeforeValidator(_names, json_schema_input_type=str | list[str]), Field(min_length=1)]


class MotionBlock(RecordedStudyBlock, SystemBlock):
    """A study that recalibrates a generic pendulum near a motion, such as energy control brings about.

    Attributes:
        write: p1 to p4, and dry friction by direction where a component takes it -> one or several component.parameter
            that hold the generic value and take the new one.
        take: balance (of energy, from the recorded voltage), invariant (Eq. 114 over the whole motion) or published
            (Eq. 118); the last two need the controller.
        controller: the energy controller, with E* and gain as they were in the recordings.
    """

    explained_by = (MotionStudy,)

    method: Literal["motion"]
    step: Seconds
    angle: AngleBlock
    speed: SpeedBlock
    voltage: VoltageBlock | None = None
    equilibrium: str
    write: dict[Lumped, Names]
    held: Literal["p1", "p3", "p4"] = "p4"
    take: Way | None = None
    controller: str | None = None
    free_runs: FreeRunsBlock | None = None
    truth: dict[str, float] = {}

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        commands = frozenset() if self.voltage is None else frozenset({self.voltage.signal})
        measured = {self.angle.signal, *([self.speed.signal] if self.speed.signal else [])}
        return UsedSignals(commands, frozenset(measured))

    @model_validator(mode="after")
    def _nothing_unused(self) -> MotionBlock:
        if self.traces.hold_out or self.traces.values:
            raise ValueError("`traces.hold_out` and `traces.values` mean nothing here; remove them")
        if self.step <= 0:
            raise ValueError("`step` must be positive")
        return self

    @model_validator(mode="after")
    def _all_four(self) -> MotionBlock:
        missing = [name for name in ("p1", "p2", "p3", "p4") if name not in self.write]
        if missing:
            raise ValueError(f"`write` lacks {missing[0]}; the generic model's value is read from there")
        if len(set(DRY) & set(self.write)) == 1:
            raise ValueError("`write` needs `dry_positive` and `dry_negative`, or neither")
        return self

    @model_validator(mode="after")
    def _can_be_taken(self) -> MotionBlock:
        if self.voltage is None and (self.taken == "balance" or self.free_runs):
            raise ValueError("`take: balance` and `free_runs` need a recorded `voltage`")
        if self.controller is None and self.taken != "balance":
            raise ValueError(f"`take: {self.taken}` needs E* and gain; name the energy `controller` of the recordings")
        if self.controller is not None and self.controller not in self.components:
            raise ValueError(f"`controller`: there is no component '{self.controller}'")
        if self.taken != "balance" and set(DRY) & set(self.write):
            raise ValueError(f"`take: {self.taken}` tells no dry friction; remove it from `write`")
        return self

    @property
    def taken(self) -> Way:
        """Whose values are written; by the voltage where it was recorded."""
        return self.take or ("invariant" if self.voltage is None else "balance")

    def study(self, base: Path) -> MotionStudy:
        """The study as plain values; `base` is the folder of its file."""
        signals = MotionSignals(
            self.angle.signal,
            self.angle.output,
            self.angle.start,
            self.speed.start,
            self.speed.signal,
            self.voltage.signal if self.voltage else None,
            self.voltage.input if self.voltage else None,
        )
        return MotionStudy(
            title=self.title,
            system=self.system(base),
            traces=self.source(base),
            signals=signals,
            step=self.step,
            equilibrium=self.equilibrium,
            write={name: tuple(targets) for name, targets in self.write.items()},
            held=self.held,
            take=self.taken,
            controller=self.controller,
            tube=TubeSpec(**dict(self.free_runs)) if self.free_runs else None,
            description=self.description,
            truth=self.truth,
        )
