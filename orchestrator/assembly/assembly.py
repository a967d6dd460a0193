"""From the `components` and `connections` of a file to FMUs on disk, and from those to a running system."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from pydantic import Field, field_validator, model_validator

from fmus import library
from fmus.errors import ScenarioError, WiringError
from fmus.modelling.model import Table
from fmus.packaging import targets
from orchestrator import formats
from orchestrator.engine import CycleSettings, Order, Simulation, Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuFile, Kind
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import IsolatedSlave, Isolation, Make
from orchestrator.fmi.slave import Slave
from orchestrator.rational import seconds
from orchestrator.solvers.base import SolverMethod, SolverSettings
from orchestrator.system import FeedThrough, Part, System, wire
from orchestrator.yaml_file import Block


class TableBlock(Block):
    """Samples that a model plays back: a signal of a trace file."""

    file: Path
    signal: str


class SolverBlock(Block):
    """How a component's derivatives are integrated; that makes it run by model exchange."""

    method: SolverMethod = SolverMethod.CVODE
    relative_tolerance: float = Field(1e-6, ge=1e-12, le=0.1)
    most_steps: int = Field(10_000, ge=1)


class ComponentBlock(Block):
    """One component: a model of the library (or a model file), or an FMU file; and its values."""

    model: str | None = None
    fmu: Path | None = None
    parameters: dict[str, Value] = {}
    tables: dict[str, TableBlock] = {}
    step: Fraction | None = None
    feed_through: FeedThrough = "declared"
    solver: SolverBlock | None = None

    @field_validator("step", mode="before")
    @classmethod
    def _exact(cls, value: Any) -> Any:
        return exact_seconds(value)

    @model_validator(mode="after")
    def _one_source(self) -> ComponentBlock:
        if (self.model is None) == (self.fmu is None):
            raise ValueError("give either `model` or `fmu`")
        if self.tables and self.model is None:
            raise ValueError("`tables` need a `model`")
        return self

    def opened(self, path: Path) -> FmuFile:
        """Its FMU, with the interface that it is run by."""
        return FmuFile(path, Kind.MODEL_EXCHANGE if self.solver else None)

    def maker(self, file: FmuFile) -> Make:
        """What makes an instance of its FMU, here or in a process that knows nothing of this block."""
        if file.kind is Kind.CO_SIMULATION:
            return Slave
        settings = SolverSettings(**self.solver.model_dump()) if self.solver else None
        return partial(ExchangeSlave, settings=settings)


class CyclesBlock(Block):
    """How cycles of direct feed-through are iterated."""

    iterate: bool = True
    tolerance: float = Field(1e-10, gt=0)
    limit: int = Field(50, ge=1)


class RunBlock(Block):
    """When a run stops and how it steps."""

    stop: Fraction
    step: Fraction
    start: Fraction = Fraction(0)
    order: Order = Order.GAUSS_SEIDEL
    cycles: CyclesBlock | None = None

    @field_validator("stop", "step", "start", mode="before")
    @classmethod
    def _exact(cls, value: Any) -> Any:
        return exact_seconds(value)

    @model_validator(mode="after")
    def _positive(self) -> RunBlock:
        if self.step <= 0 or self.stop <= self.start:
            raise ValueError("`step` must be positive and `stop` after `start`")
        return self

    def timing(self) -> Timing:
        cycles = CycleSettings(**self.cycles.model_dump()) if self.cycles else CycleSettings()
        return Timing(self.stop, self.step, self.start, self.order, cycles)


class SystemBlock(Block):
    """Components and how they are wired: `source -> target`, one a line."""

    components: dict[str, ComponentBlock] = Field(min_length=1)
    connections: list[str] = []

    @field_validator("components")
    @classmethod
    def _names(cls, value: dict[str, ComponentBlock]) -> dict[str, ComponentBlock]:
        for name in value:
            if not name.isidentifier():
                raise ValueError(f"component '{name}': use letters, digits and underscores")
        return value

    @field_validator("connections")
    @classmethod
    def _arrows(cls, value: list[str]) -> list[str]:
        for line in value:
            if line.count("->") != 1:
                raise ValueError(f"'{line}': write source -> target")
        return value

    def links(self) -> list[tuple[str, str]]:
        """(source, target) of each connection."""
        return [(line.split("->")[0].strip(), line.split("->")[1].strip()) for line in self.connections]

    def values(self) -> dict[str, Value]:
        """component.variable -> value, of all components."""
        return {
            f"{name}.{variable}": value
            for name, block in self.components.items()
            for variable, value in block.parameters.items()
        }


@dataclass(frozen=True)
class Assembled:
    """Everything needed to open a system in any process: paths and plain values only.

    Attributes:
        files: component -> FMU file.
        built: component -> whether the file was made from one of our models.
    """

    files: Mapping[str, Path]
    built: Mapping[str, bool]
    block: SystemBlock
    stimulated: tuple[str, ...] = ()


def assemble(
    block: SystemBlock,
    base: Path,
    folder: Path,
    stimulated: tuple[str, ...] = (),
    target: str | None = None,
) -> Assembled:
    """Build the FMUs of the components that are given as models, into `folder`; paths are relative to `base`.

    Args:
        target: how models are packaged, "native" or "python"; None takes the preferred one.
    """
    files = {}
    for name, component in block.components.items():
        if component.fmu is not None:
            files[name] = base / component.fmu
            continue
        assert component.model is not None
        model = library.find(str(base / component.model) if component.model.endswith(".py") else component.model)
        tables = {key: _table(key, each, base) for key, each in component.tables.items()}
        files[name] = targets.build(target or targets.preferred(), model, folder / f"{name}.fmu", tables=tables)
    built = {name: component.fmu is None for name, component in block.components.items()}
    return Assembled(files, built, block, stimulated)


class OpenSystem:
    """FMU files opened, wired and checked; a context manager that closes them."""

    def __init__(self, assembled: Assembled) -> None:
        self._stack = ExitStack()
        self.assembled = assembled
        try:
            self._files = {
                name: self._stack.enter_context(assembled.block.components[name].opened(path))
                for name, path in assembled.files.items()
            }
            self.system: System = self._wire()
        except BaseException:
            self._stack.close()
            raise

    def simulation(self, timing: Timing, isolation: Isolation | None = None) -> Simulation:
        """A simulation of fresh instances, closed with this system.

        Args:
            isolation: how FMUs that were not made from our models are isolated, None where they are not.
        """
        components: dict[str, Component] = {}
        for name, file in self._files.items():
            make = self.assembled.block.components[name].maker(file)
            if isolation is None or self.assembled.built[name]:
                components[name] = make(file, name)
            else:
                components[name] = IsolatedSlave(make, file, name, isolation)
            self._stack.callback(components[name].close)
        return Simulation(self.system, components, timing)

    def _wire(self) -> System:
        blocks = self.assembled.block.components
        parts = {
            name: Part(file.interface, blocks[name].step, blocks[name].feed_through)
            for name, file in self._files.items()
        }
        return wire(parts, self.assembled.block.links(), self.assembled.stimulated)

    def close(self) -> None:
        """Free the instances and remove the unpacked FMUs."""
        self._stack.close()

    def __enter__(self) -> OpenSystem:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()


def _table(name: str, block: TableBlock, base: Path) -> Table:
    trace = formats.read(base / block.file).trace
    return Table(name, tuple(trace.time.tolist()), tuple(trace[block.signal].tolist()))


def exact_seconds(value: Any) -> Any:
    """A field's value as an exact time, for validators of schemas."""
    if value is None:
        return None
    try:
        return seconds(value)
    except (WiringError, ScenarioError) as error:
        raise ValueError(error.problem) from error
