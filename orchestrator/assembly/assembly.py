"""From components and connections, as plain values, to FMUs on disk, and from those to a running system."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

from fmus import library
from fmus.errors import WiringError
from fmus.modelling.model import Model, Table
from fmus.packaging import targets
from orchestrator.assembly.remarks import remarks, sampling
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.assembly.whole_arrays import check_shapes
from orchestrator.assembly.whole_terminals import by_variables
from orchestrator.assembly.wiring import wire
from orchestrator.crossing import logged, quantity
from orchestrator.engine import Engine, Result, RunProfile, Simulation, Timing
from orchestrator.engine.profile import Watched
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.component import Component
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuFile, FmuKind
from orchestrator.fmi.interface import Value, Written
from orchestrator.fmi.isolation import IsolatedSlave, Isolation
from orchestrator.fmi.isolation_worker import Make
from orchestrator.fmi.slave import Slave
from orchestrator.fmi.within.intermediate import check, maker
from orchestrator.network.bus_spec import BusSpec
from orchestrator.network.carriers import interface
from orchestrator.network.joining import Joined, exchanged, have_exchange, joined
from orchestrator.rational import seconds
from orchestrator.solvers.base import SolverSettings
from orchestrator.system import Endpoint, FeedThrough, Part, System
from orchestrator.trace import Trace

LOG = logging.getLogger("servotwin.assembly")


@dataclass(frozen=True)
class ComponentSpec:
    """What a component is made of and how it is run.

    Attributes:
        source: an FMU file; or a model, the name of one of the library, or a model file (.py).
        parameters: variable -> parameter or start value [unit of the variable]; the others have the FMU's defaults.
        tables: what a model plays back; only of models.
        arrays: shapes of the arrays whose elements are all given.
        step: its communication step [s]; None takes the run's.
        feed_through: whether its outputs react to inputs within a step, see `Part`.
        intermediate: variables whose values are kept whenever the FMU tells of them within a step.
        solver: how its derivatives are integrated, which makes it run by model exchange; None runs co-simulation.
    """

    source: str | Path | Model
    parameters: Mapping[str, Value] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    step: Fraction | None = None
    feed_through: FeedThrough = "declared"
    solver: SolverSettings | None = None
    arrays: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    intermediate: tuple[str, ...] = ()

    @property
    def fmu(self) -> Path | None:
        """The FMU file, None where it is a model."""
        if isinstance(self.source, Model):
            return None
        path = Path(self.source)
        given = isinstance(self.source, Path) and path.suffix != ".py"
        return path if given or path.suffix.lower() == ".fmu" else None

    def open(self, file: Path) -> FmuFile:
        """Its FMU, with the interface that it is run by."""
        return FmuFile(file, FmuKind.MODEL_EXCHANGE if self.solver else None, self.parameters)

    def maker(self, file: FmuFile) -> Make:
        """What makes an instance of its FMU, here or in another process."""
        if file.kind is not FmuKind.CO_SIMULATION:
            return partial(ExchangeSlave, settings=self.solver)
        if self.intermediate:
            return partial(maker(file.interface), variables=self.intermediate)
        return ClockedSlave if file.interface.ticks else Slave


@dataclass(frozen=True)
class SystemSpec:
    """Components by name, what is connected: (source, target), each component.variable; and the buses between them."""

    components: Mapping[str, ComponentSpec]
    connections: tuple[tuple[str, str], ...] = ()
    buses: Mapping[str, BusSpec] = field(default_factory=dict)

    def values(self) -> dict[str, Value]:
        """component.variable -> value, of all components."""
        return {
            f"{name}.{variable}": value
            for name, component in self.components.items()
            for variable, value in component.parameters.items()
        }

    def given(self, values: Mapping[str, Value]) -> SystemSpec:
        """The system with these values, component.variable -> value, over those of its components."""
        own: dict[str, dict[str, Value]] = {name: dict(one.parameters) for name, one in self.components.items()}
        for name, value in values.items():
            component, _, variable = name.partition(".")
            own.get(component, {})[variable] = value
        return replace(self, components={n: replace(one, parameters=own[n]) for n, one in self.components.items()})


@dataclass(frozen=True)
class Assembled:
    """Everything needed to open a system in any process: paths and plain values only.

    Attributes:
        files: component -> FMU file.
        built: components whose file was made from a model.
        system: how the files are run and wired.
        stimulated: component.input that are driven from outside.
    """

    files: Mapping[str, Path]
    built: frozenset[str]
    system: SystemSpec
    stimulated: tuple[str, ...] = ()


def assemble(system: SystemSpec, folder: Path, stimulated: Iterable[str] = (), target: str | None = None) -> Assembled:
    """Build the FMUs of the components that are given as models, into `folder`.

    Args:
        target: how models are packaged, "native" or "python"; None takes the preferred one.

    Raises:
        ModelError: a model is not there, or cannot be built.
    """
    files, components = {}, {}
    for name, component in system.components.items():
        file = component.fmu or _built(name, component, folder, target)
        parameters = _in_numbers(name, component, file)
        files[name], components[name] = file, replace(component, source=file, tables=(), parameters=parameters)
    built = frozenset(name for name, component in system.components.items() if component.fmu is None)
    return Assembled(files, built, replace(system, components=components), tuple(stimulated))


def _in_numbers(name: str, component: ComponentSpec, file: Path) -> Mapping[str, Value]:
    """The parameters, those that are written as `3000 rpm` in the unit of their variables."""
    written = [key for key, value in component.parameters.items() if _to_be_read(value)]
    if not written:
        return component.parameters
    with component.open(file) as fmu:
        ports = {key: fmu.interface.ports[key] for key in written if key in fmu.interface.ports}
    typed = {key: port.typed(f"{name}.{key}", component.parameters[key]) for key, port in ports.items()}
    return {**component.parameters, **typed}


def _to_be_read(value: Value) -> bool:
    """Whether only its variable tells what it is."""
    return isinstance(value, Written) or (isinstance(value, str) and quantity(value) is not None)


def _built(name: str, component: ComponentSpec, folder: Path, target: str | None) -> Path:
    tables = {table.name: table for table in component.tables}
    return targets.build(model_of(component), folder / f"{name}.fmu", target=target, tables=tables)


def model_of(component: ComponentSpec) -> Model:
    """The model of a component that is given as one, of the size of its arrays.

    Raises:
        ModelError: there is none of this name, or its file cannot be used.
    """
    source = component.source
    return library.of_size(source if isinstance(source, Model) else library.find(str(source)), component.arrays)


class OpenSystem:
    """FMU files opened, wired and checked; a context manager that closes them."""

    def __init__(self, assembled: Assembled) -> None:
        self._stack = ExitStack()
        self.assembled = assembled
        try:
            self._files = {
                name: self._stack.enter_context(component.open(assembled.files[name]))
                for name, component in assembled.system.components.items()
            }
            self._buses = joined(self.assembled.system.buses, self._files)
            self.system: System = self._wire()
        except BaseException:
            self._stack.close()
            raise

    def simulation(
        self, timing: Timing, isolation: Isolation | None = None, profile: RunProfile | None = None
    ) -> Simulation:
        """A simulation of fresh instances, closed with this system.

        Args:
            isolation: how FMUs that were not made from our models are isolated, None where they are not.
            profile: what takes note of every step, which the loop in Python then does.
        """
        components: dict[str, Component] = {}
        for name, file in self._files.items():
            component = self.assembled.system.components[name]
            if remark := sampling(file.interface, component.parameters, component.step or timing.step):
                _say(f"{name}: {remark}")
            make = component.maker(file)
            if isolation is not None and component.intermediate:
                raise WiringError(f"components.{name}.intermediate", "cannot be isolated", "remove it, or --isolate")
            if isolation is None or name in self.assembled.built:
                components[name] = make(file, name)
            else:
                components[name] = IsolatedSlave(make, file, name, isolation)
            self._stack.callback(components[name].close)
        carriers: dict[str, Component] = {
            name: bus.carrier(name, self._nodes(bus, components)) for name, bus in self._buses.items()
        }
        if profile is None:
            return Simulation(self.system, components | carriers, timing)
        watched = {name: Watched(component, profile) for name, component in components.items()}
        return Simulation(self.system, {**watched, **carriers}, replace(timing, engine=Engine.PYTHON))

    def _nodes(self, bus: Joined, components: Mapping[str, Component]) -> dict[str, ClockedSlave]:
        """The instances on a bus, which exchange what it carries."""
        slaves: dict[str, ClockedSlave] = {}
        for name in bus.components:
            slave = components[name]
            if not isinstance(slave, ClockedSlave):
                problem = "is on a bus, and can be neither isolated nor run by model exchange"
                raise WiringError(name, problem, "remove --isolate, or its `solver`")
            have_exchange(slave, exchanged(self._buses, name))
            slaves[name] = slave
        return slaves

    def run(
        self,
        stop: float | str | Fraction,
        step: float | str | Fraction,
        values: Mapping[str, Value] | None = None,
        stimuli: Mapping[str, float | Trace | Stimulus] | None = None,
        record: Iterable[str] | None = None,
    ) -> Result:
        """What fresh instances give from 0 to `stop`, with a communication step of `step` [s].

        Args:
            values: component.variable -> parameter or start value, over those of the components.
            stimuli: component.input -> a constant or a trace with one signal, for each input that is driven.
            record: component.variable that are numbers; None takes all outputs.

        Raises:
            WiringError: a name, value or time does not fit the system.
            TraceError: a stimulus has no value somewhere.
            FmuError: an FMU failed.
        """
        driven = {
            name: given if isinstance(given, Stimulus) else Stimulus(given) for name, given in (stimuli or {}).items()
        }
        crossed = []
        for name, stimulus in driven.items():
            driven[name], how = stimulus.brought(name, self.system.port(Endpoint.parse(name)))
            crossed += [] if how is None else [how]
        logged(crossed)
        with self.simulation(Timing(seconds(stop, "stop"), seconds(step, "step"))) as simulation:
            samples = {name: stimulus.values(simulation.instants(), name) for name, stimulus in driven.items()}
            result = simulation.run({**self.assembled.system.values(), **(values or {})}, samples, record)
        if result.ended:
            LOG.warning("%s; the run ends there", result.ended)
        return result

    @property
    def files(self) -> Mapping[str, FmuFile]:
        """Component -> its FMU."""
        return self._files

    def _wire(self) -> System:
        components = self.assembled.system.components
        parts = {
            name: Part(
                file.interface,
                components[name].step,
                components[name].feed_through,
                frozenset(one for terminal in exchanged(self._buses, name) for one in terminal.carried),
            )
            for name, file in self._files.items()
        }
        parts |= {name: Part(interface(bus.spec), carries=bus.components) for name, bus in self._buses.items()}
        connections = by_variables(self.assembled.system.connections, parts, self.assembled.files)
        system = wire(parts, connections, self.assembled.stimulated)
        for name, component in components.items():
            place, kind = f"components.{name}.intermediate", self._files[name].kind
            check(place, parts[name].interface, kind, component.intermediate)
            check_shapes(system, {f"{name}.{array}": shape for array, shape in component.arrays.items()})
            for remark in remarks(system, name, component.parameters):
                _say(f"{name}: {remark}")
        return system

    def close(self) -> None:
        """Free the instances and remove the unpacked FMUs."""
        self._stack.close()

    def __enter__(self) -> OpenSystem:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@cache
def _say(remark: str) -> None:
    """Say it once in a process."""
    LOG.warning("%s", remark)


def open_system(
    components: Mapping[str, ComponentSpec | Model | str | Path],
    connections: Iterable[str] = (),
    stimulated: Iterable[str] = (),
) -> OpenSystem:
    """Components wired to a system that can be run; a context manager.

    Args:
        components: name -> an FMU file, a model of the library by its name, a model file, or a `ComponentSpec`.
        connections: `component.output -> component.input` each.
        stimulated: component.input that every run drives from outside.

    Raises:
        ModelError, FmuFileError: a component cannot be built or opened.
        WiringError: names, units or types do not fit, or an input has no source or two.
    """
    specs = {
        name: given if isinstance(given, ComponentSpec) else ComponentSpec(given) for name, given in components.items()
    }
    system = SystemSpec(specs, tuple(map(link, connections)))
    with tempfile.TemporaryDirectory(prefix="servotwin-") as folder:
        return OpenSystem(assemble(system, Path(folder), stimulated))


def link(line: str) -> tuple[str, str]:
    """Source and target of a connection.

    Raises:
        WiringError: it is not written as one.
    """
    source, arrow, target = line.partition("->")
    if not arrow or "->" in target:
        raise WiringError(f"'{line}'", "is no connection", "write source -> target")
    return source.strip(), target.strip()
