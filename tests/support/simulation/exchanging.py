"""What the tests of model exchange share: FMUs kept open, simulations of them, and two masses whose motion is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import library
from fmus.modelling.model import Model, State, input_, output, parameter
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from orchestrator.assembly.wiring import wire
from orchestrator.engine import REFUSED, CycleSettings, Simulation, Timing
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuFile, FmuKind
from orchestrator.fmi.interface import Value
from orchestrator.solvers.base import SolverMethod, SolverSettings
from orchestrator.system import FeedThrough, Part
from orchestrator.trace import FloatArray, Trace
from tests.support.fmus import eventful
from tests.support.simulation.scripted import Scripted
from tests.support.tools import third_party

TIGHT = SolverSettings(relative_tolerance=1e-10)
METHODS = [SolverSettings(method, 1e-9) for method in SolverMethod]
TENTH = Fraction(1, 10)


def two_masses() -> Model:
    """A mass on a spring, and another one joined to it by spring and damper, which a force pulls."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        joint = p.k * (x.x1 - x.x2) + p.d * (x.v1 - x.v2)
        return {"x1": x.v1, "v1": u.force - joint, "x2": x.v2, "v2": joint - x.x2}

    return Model(
        name="two_masses",
        description="Two masses",
        derivatives=derivatives,
        variables=(
            input_("force", "1", "Force on the first mass"),
            output("x1", "1", "Position of the first mass"),
            output("x2", "1", "Position of the second mass"),
            parameter("k", "1", 2.0, "Stiffness"),
            parameter("d", "1", 0.1, "Damping"),
            parameter("x1_start", "1", 1.0, "Where the first mass starts"),
        ),
        states=(State("x1", "x1_start"), State("v1"), State("x2"), State("v2")),
        solver_step=lambda p: 1e-3,
    )


def matrices(k: float = 2.0, d: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """A and B of the two masses; the states are x1, v1, x2, v2."""
    A = np.array([[0, 1, 0, 0], [-k, -d, k, d], [0, 0, 0, 1], [k, d, -k - 1, -d]], dtype=float)
    return A, np.array([[0.0], [1.0], [0.0], [0.0]])


Shelf = Callable[[str], FmuFile]


@contextmanager
def open_shelf(folder: Path) -> Iterator[Shelf]:
    """name -> FMU opened for model exchange: "masses2", "masses3", "eventful", "controller", "BouncingBall3", ..."""
    opened: dict[str, FmuFile] = {}

    def path(name: str) -> Path:
        if name in ("eventful", "controller"):
            return eventful.build(folder, "x" if name == "eventful" else "sample")
        model, version = name[:-1], int(name[-1])
        if model not in ("masses", "pendulum"):
            return third_party.reference(version, model)
        if not compiler.available():
            pytest.skip("no C compiler here")
        source = two_masses() if model == "masses" else library.find(model)
        return targets.build(source, folder / f"{name}.fmu", fmi=version, target="native")

    def get(name: str) -> FmuFile:
        if name not in opened:
            opened[name] = FmuFile(path(name), FmuKind.MODEL_EXCHANGE)
        return opened[name]

    yield get
    for file in opened.values():
        file.close()


@contextmanager
def simulation(
    components: Mapping[str, FmuFile | Scripted],
    links: Sequence[tuple[str, str]] = (),
    *,
    step: Fraction = TENTH,
    stop: Fraction = Fraction(2),
    start: Fraction = Fraction(0),
    solver: SolverSettings = TIGHT,
    stimulated: Sequence[str] = (),
    cycles: CycleSettings = REFUSED,
    feed_through: FeedThrough = "declared",
) -> Iterator[Simulation]:
    with ExitStack() as stack:
        made = {}
        for name, each in components.items():
            made[name] = each if isinstance(each, Scripted) else ExchangeSlave(each, name, solver)
            stack.callback(made[name].close)
        parts = {name: Part(each.interface, feed_through=feed_through) for name, each in components.items()}
        yield Simulation(wire(parts, links, stimulated), made, Timing(stop, step, start, cycles=cycles))


def trace(fmu: FmuFile, values: Mapping[str, Value] | None = None, **more: Any) -> Trace:
    """The outputs of one FMU, "fmu", run alone."""
    stimuli = more.pop("stimuli", None)
    with simulation({"fmu": fmu}, stimulated=list(stimuli or {}), **more) as made:
        return made.run({f"fmu.{name}": value for name, value in (values or {}).items()}, stimuli).trace


def only(made: Simulation) -> ExchangeSlave:
    """The FMU "fmu" of a simulation."""
    slave = made.components["fmu"]
    assert isinstance(slave, ExchangeSlave)
    return slave


def same(one: Trace, other: Trace) -> bool:
    return one.names == other.names and all(np.array_equal(one[name], other[name]) for name in one.names)


def with_xml(source: Path, folder: Path, *replacements: tuple[str, str]) -> Path:
    """A copy of an FMU with these changes to its description."""
    files = archive.read(source)
    text = files["modelDescription.xml"].decode()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    archive.write(folder / "changed.fmu", {**files, "modelDescription.xml": text.encode()})
    return folder / "changed.fmu"
