"""How a file describes a system and the times of its run; read once and turned into plain values."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from fmus.errors import TraceError, WiringError
from fmus.modelling.model import Table
from orchestrator import formats
from orchestrator.assembly.assembly import ComponentSpec, SystemSpec, link
from orchestrator.assembly.whole_arrays import Values, elements, shapes
from orchestrator.crossing import GivenConversion
from orchestrator.engine import CycleSettings, Order, StepControl, Timing
from orchestrator.fmi.interface import Value
from orchestrator.formats.schema import LayoutBlock
from orchestrator.marks import listed
from orchestrator.solvers.base import SolverMethod, SolverSettings
from orchestrator.system import FeedThrough
from orchestrator.trace import Trace
from orchestrator.yaml_file import Block, FileWithSuffix, Seconds, may_be_partial

LOG = logging.getLogger("servotwin.recordings")


class SignalFileBlock(Block):
    """A signal of a trace file.

    Attributes:
        file: the recording, relative to this file.
        signal: its name there.
        factor, offset: variable = factor * signal + offset, over what their units say.
        layout: how the file is laid out, where it does not tell.
    """

    file: Path
    signal: str
    factor: float | None = None
    offset: float | None = None
    layout: LayoutBlock = LayoutBlock()

    @property
    def given(self) -> GivenConversion:
        """What it is converted by, over its unit."""
        return GivenConversion(self.factor, self.offset)

    def trace(self, base: Path, said: list[str] | None = None) -> Trace:
        """The signal alone; the file is relative to `base`. What is to be known of it is logged and added to `said`."""
        recording = formats.read(base / self.file, self.layout.layout(base))
        marks = [mark for mark in recording.marks if mark.concerns([self.signal])]
        notes = (*recording.notes, *([f"is used across {listed(marks)}"] if marks else []))
        for note in notes:
            LOG.warning("%s: %s", recording.path, note)
        if said is not None:
            said += [f"{self.file}: {note}" for note in notes]
        try:
            return recording.trace.select([self.signal])
        except TraceError as error:
            raise TraceError(recording.path, error.problem, error.fix) from None

    def table(self, name: str, base: Path, said: list[str] | None = None) -> Table:
        """The signal as a table that a model plays back."""
        trace = self.trace(base, said)
        values = (1.0 if self.factor is None else self.factor) * trace[self.signal] + (self.offset or 0.0)
        return Table(name, tuple(trace.time.tolist()), tuple(values.tolist()))


class SolverBlock(Block):
    """How a component's derivatives are integrated; that makes it run by model exchange.

    Attributes:
        method: the solver.
    """

    explained_by = (SolverSettings,)

    method: SolverMethod = SolverSettings.method
    relative_tolerance: float = Field(SolverSettings.relative_tolerance, ge=1e-12, le=0.1)
    most_steps: int = Field(SolverSettings.most_steps, ge=1)


class ComponentBlock(Block):
    """One component: a model of the library (or a model file), or an FMU file; and its values.

    Attributes:
        model: name of a model of the library, or a model file (`.py`) relative to this file.
        fmu: an FMU file, relative to this file; instead of `model`.
        tables: name of a table of the model -> the recording that it plays back.
    """

    explained_by = (ComponentSpec,)

    model: Annotated[str, FileWithSuffix(".py")] | None = None
    fmu: Path | None = None
    parameters: Values = {}
    tables: dict[str, SignalFileBlock] = {}
    step: Seconds | None = None
    feed_through: FeedThrough = ComponentSpec.feed_through
    solver: SolverBlock | None = None
    intermediate: list[str] = []

    @model_validator(mode="after")
    def _one_source(self) -> ComponentBlock:
        if (self.model is None) == (self.fmu is None):
            raise ValueError("give either `model` or `fmu`")
        if self.tables and self.model is None:
            raise ValueError("`tables` need a `model`")
        return self

    def spec(self, base: Path, said: list[str] | None = None) -> ComponentSpec:
        """The component; its files are relative to `base`, and what is to be known of them is added to `said`."""
        source: str | Path = base / self.fmu if self.fmu is not None else str(self.model)
        if self.model is not None and self.model.endswith(".py"):
            source = str(base / self.model)
        tables = tuple(block.table(name, base, said) for name, block in self.tables.items())
        made = self.made_of(source, elements(self.parameters))
        return replace(made, tables=tables, arrays=shapes(self.parameters))

    def made_of(self, source: str | Path, parameters: Mapping[str, Value]) -> ComponentSpec:
        """The component with a model or FMU in its place, such as a calibrated one, and these values."""
        solver = SolverSettings(**dict(self.solver)) if self.solver else None
        made = ComponentSpec(source, parameters, (), self.step, self.feed_through, solver)
        return replace(made, intermediate=tuple(self.intermediate))

    def replaced(self, file: Path) -> ComponentBlock:
        """The same with an FMU in its place, which has its values in it."""
        return self.model_copy(update={"model": None, "fmu": file.resolve(), "parameters": {}, "tables": {}})


class CyclesBlock(Block):
    """How cycles of direct feed-through are iterated."""

    explained_by = (CycleSettings,)

    iterate: bool = CycleSettings.iterate
    tolerance: float = Field(CycleSettings.tolerance, gt=0)
    limit: int = Field(CycleSettings.limit, ge=1)


class ControlledStepBlock(Block):
    """Steps whose length follows from their error; with `order: iterated`.

    Attributes:
        most: the communication step, at whose ends rows are recorded and stimuli change [s].
        least: no step is shorter [s]; one that misses the tolerance all the same counts, and is told.
    """

    explained_by = (StepControl,)

    tolerance: float = Field(gt=0, lt=1)
    least: Seconds
    most: Seconds


class RunBlock(Block):
    """When a run stops and how it steps.

    Attributes:
        stop: when the run ends [s].
        step: the communication step, from which all others are multiples [s]; or between which lengths it is chosen by
            its error.
        start: when the run begins [s].
        order: whether components of a step run one after the other, `gauss-seidel`, all with what was before it,
            `jacobi`, or again and again until what they take and give over it agrees, `iterated`.
        cycles: how cycles of direct feed-through are iterated; without it they are refused.
        nonfinite: whether an output that is NaN or infinite ends the run, or is allowed and counted.
    """

    explained_by = (Timing,)

    model_config = ConfigDict(json_schema_extra=may_be_partial)

    stop: Seconds
    step: Seconds | ControlledStepBlock
    start: Seconds = Timing.start
    order: Order = Timing.order
    cycles: CyclesBlock | None = None
    nonfinite: Literal["refuse", "allow"] = "refuse"
    tolerance: float | None = Field(Timing.tolerance, gt=0, lt=1)
    tell_stop: bool = Timing.tell_stop

    @model_validator(mode="after")
    def _positive(self) -> RunBlock:
        if self.most <= 0 or self.stop <= self.start:
            raise ValueError("`step` must be positive and `stop` after `start`")
        if isinstance(self.step, ControlledStepBlock):
            if self.order is not Order.ITERATED:
                raise ValueError("a `step` with a tolerance needs `order: iterated`")
            if not 0 < self.step.least <= self.step.most / 2:
                raise ValueError("`step.least` must be positive and at most half of `step.most`")
        return self

    @property
    def most(self) -> Fraction:
        """The communication step [s]."""
        return self.step.most if isinstance(self.step, ControlledStepBlock) else self.step

    def timing(self) -> Timing:
        """The times and how cycles are iterated; without `cycles` they are refused."""
        cycles = CycleSettings(**dict(self.cycles)) if self.cycles else Timing.cycles
        own = self.step
        control = StepControl(own.tolerance, own.least) if isinstance(own, ControlledStepBlock) else None
        return Timing(
            self.stop,
            self.most,
            self.start,
            self.order,
            cycles,
            tolerance=self.tolerance,
            tell_stop=self.tell_stop,
            finite=self.nonfinite == "refuse",
            control=control,
        )


def _named_plainly(components: dict[str, ComponentBlock]) -> dict[str, ComponentBlock]:
    for name in components:
        if not name.isidentifier():
            raise ValueError(f"component '{name}': use letters, digits and underscores")
    return components


def _with_arrows(connections: list[str]) -> list[str]:
    for line in connections:
        try:
            link(line)
        except WiringError as error:
            raise ValueError(f"{error.place}: {error.fix}") from error
    return connections


Components = Annotated[dict[str, ComponentBlock], AfterValidator(_named_plainly)]
Connections = Annotated[list[str], AfterValidator(_with_arrows)]


class SystemBlock(Block):
    """Components and how they are wired.

    Attributes:
        include: files with parts, and SSPs, that it is joined with, relative to it; what it says itself counts.
        components: name -> what it is.
        connections: `component.output -> component.input`, one a line; `2.5 * component.output + 1 -> ...` converts by
            a factor and an offset over what the units say; `component.terminal -> component.terminal` joins terminals.
    """

    include: list[Path] = []
    components: Annotated[Components, Field(min_length=1)]
    connections: Connections = []

    def system(self, base: Path, said: list[str] | None = None) -> SystemSpec:
        """Components and connections; files are relative to `base`, and what is to be known of them added to `said`."""
        return SystemSpec({name: block.spec(base, said) for name, block in self.components.items()}, self.links())

    def links(self) -> tuple[tuple[str, str], ...]:
        """(source, target) of each connection."""
        return tuple(map(link, self.connections))

    def values(self) -> dict[str, Value]:
        """component.variable -> value, of all components."""
        return {
            f"{name}.{variable}": value
            for name, block in self.components.items()
            for variable, value in elements(block.parameters).items()
        }
