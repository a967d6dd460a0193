"""What tests of the compiled loop share: FMUs of all kinds kept open, and both engines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import FmuError
from fmus.packaging import targets
from orchestrator.assembly.wiring import wire
from orchestrator.engine import (
    Engine,
    Order,
    Result,
    RunFailed,
    Simulation,
    Timing,
    compiled,
)
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part, System
from orchestrator.trace import FloatArray, Trace
from tests.support.fmus import moody
from tests.support.tools import third_party

STEP = Fraction(1, 5)  # [s], a multiple of the fixed steps of all FMUs below
MODELS = ("Feedthrough", "Dahlquist", "VanDerPol", "Stair", "BouncingBall")
BOTH = (Engine.PYTHON, Engine.COMPILED)


needs_loop = pytest.mark.skipif(not compiled.available(), reason="the compiled loop was not built")


Shelf = Mapping[str, FmuFile]


@contextmanager
def open_shelf(folder: Path) -> Iterator[Shelf]:
    """Reference FMUs of both versions as "Stair2", "Stair3", ..., and two Python FMUs."""
    paths = {f"{model}{version}": third_party.reference(version, model) for model in MODELS for version in (2, 3)}
    for name in ("pendulum", "daq"):
        paths[name] = targets.build(name, folder / f"{name}.fmu", target="python")
    paths["moody"] = moody.build(folder)
    with ExitStack() as stack:
        yield {name: stack.enter_context(FmuFile(path)) for name, path in paths.items()}


def bits(trace: Trace) -> dict[str, bytes]:
    return {"time": trace.time.tobytes(), **{name: trace[name].tobytes() for name in trace.names}}


@dataclass(frozen=True)
class Case:
    """A system and a run of it; components are c0, c1, ...

    Attributes:
        scale: target -> factor and offset of its connection.
    """

    kinds: tuple[str, ...]
    links: tuple[tuple[str, str], ...] = ()
    scale: Mapping[str, tuple[float, float]] | None = None
    every: tuple[int, ...] = ()
    order: Order = Order.GAUSS_SEIDEL
    stimuli: Mapping[str, FloatArray] | None = None
    values: Mapping[str, Value] | None = None
    steps: int = 20
    step: Fraction = STEP
    start: Fraction = Fraction(0)
    record_every: int = 1

    def system(self, shelf: Shelf) -> System:
        every = self.every or (1,) * len(self.kinds)
        parts = {
            f"c{i}": Part(shelf[kind].interface, each * self.step)
            for i, (kind, each) in enumerate(zip(self.kinds, every, strict=True))
        }
        wired = wire(parts, self.links, self.stimuli or {})
        scale = self.scale or {}
        links = tuple(
            replace(link, factor=scale[str(link.target)][0], offset=scale[str(link.target)][1])
            if str(link.target) in scale
            else link
            for link in wired.connections
        )
        return replace(wired, connections=links)

    def simulation(self, shelf: Shelf, engine: Engine) -> Simulation:
        timing = Timing(self.start + self.steps * self.step, self.step, self.start, self.order, engine=engine)
        slaves = {f"c{i}": Slave(shelf[kind], f"c{i}") for i, kind in enumerate(self.kinds)}
        return Simulation(self.system(shelf), slaves, timing)

    def run(self, shelf: Shelf, engine: Engine, **more: Any) -> Result:
        with self.simulation(shelf, engine) as made:
            inputs = [target for _, target in self.links] + list(self.stimuli or {})
            record = [*inputs[::2], *made.outputs, *inputs[1::2]]
            return made.run(self.values, self.stimuli, record, record_every=self.record_every, **more)

    def outcome(self, shelf: Shelf, engine: Engine) -> Any:
        """All that can be seen of a run: bits of every sample, calls and warnings; or the error."""
        try:
            result = self.run(shelf, engine)
        except RunFailed as error:
            return str(error), bits(error.result.trace), error.result.account.reached
        except FmuError as error:
            return str(error)
        calls = {name: each.calls for name, each in result.statistics.items()}
        return result.ended, bits(result.trace), calls, dict(result.warnings)
