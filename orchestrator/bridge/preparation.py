"""All that can be refused of a coupling, before it takes its place on a bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import InputError, ScenarioError
from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.assembly.whole_arrays import check_shapes, elements, shapes
from orchestrator.bridge.mapping import Coupling, coupled
from orchestrator.bridge.session import Course
from orchestrator.bridge.signals.outputs import SentMessage
from orchestrator.can import frame_time
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.database.database import Database
from orchestrator.can.database.sources import ALL, DatabaseFiles, paths
from orchestrator.can.live.bus import BusSettings, OnBuses
from orchestrator.crossing import Crossing, logged
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import scratch
from orchestrator.live.steering import Steering
from orchestrator.rational import multiples
from orchestrator.scenario.can_block import CanBlock
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import typed
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class BridgeJob(OnBuses):
    """What is coupled to which bus.

    Attributes:
        stand_in: whether it is the machine: it then goes on whatever becomes of bus and peers, and is not judged.
        steering: what may be changed meanwhile; nothing by default.
        others: buses that it is coupled to, too; channels are numbered in this order, `bus` is 0.
        case: of the scenario, the first by default.
        overrides: component.variable -> value, over those of the file.
        duration: by default the scenario's, or for a stand-in until told to end [s].
        every: communication steps from one row of the record to the next.
        fmus: component -> FMU file in its place.
    """

    scenario: Path
    bus: BusSettings
    stand_in: bool = False
    case: str | None = None
    overrides: Mapping[str, Value | list[Any]] = field(default_factory=dict)
    duration: Fraction | None = None
    every: int = 1
    fmus: Mapping[str, Path] = field(default_factory=dict)
    others: tuple[BusSettings, ...] = ()
    steering: Steering = field(default_factory=Steering)


@dataclass(frozen=True)
class PreparedBridge:
    """A system that is ready to be initialised and coupled.

    Attributes:
        database: files of the bus' messages; `notes` say what is not as in them.
        run: values, what is recorded, and what the inputs have at first.
        crossings: values that are converted, or taken as they are although their units differ.
    """

    scenario: Scenario
    case: Case
    database: tuple[Path, ...]
    notes: tuple[str, ...]
    assembled: Assembled
    simulation: Simulation
    coupling: Coupling
    run: Run
    course: Course
    crossings: tuple[Crossing, ...]


@contextmanager
def prepared(job: BridgeJob) -> Iterator[PreparedBridge]:
    """The job with its FMUs built, loaded and wired.

    Raises:
        InputError: something does not fit: the file, a name, a unit, a period, a value.
    """
    scenario = load_scenario(job.scenario, fmus=job.fmus)
    can = _can_block(scenario)
    given = _databases(can, scenario.path.parent)
    known = load_all(given, can.encoding)
    databases = [_database(known, number, scenario.path) for number in range(len(job.buses))]
    step = scenario.timing.step
    with (
        scenario.naming(job.overrides),
        scratch(None) as folder,
        OpenSystem(assemble(scenario.system.given(elements(job.overrides)), folder, scenario.driven)) as opened,
    ):
        check_shapes(opened.system, shapes(job.overrides))
        overrides = typed(opened.system, elements(job.overrides))
        coupling = coupled(can, opened.system, databases, step, job.bus.data_bitrate is not None)
        for number, bus in enumerate(job.buses):
            _check_bus(bus, [message for message in coupling.sent if message.place.number == number], step)
        scenario, crossed = in_units_of(opened.system, scenario)
        crossings = logged([*opened.system.crossings, *crossed, *coupling.crossings])
        case = _case(scenario, job.case)
        with opened.simulation(scenario.timing) as simulation:
            course, first = _course(job, scenario, simulation, coupling)
            values = {**case.values, **overrides}
            run = Run(values, first, scenario.recorded(simulation.outputs), record_every=job.every)
            assembled, files = opened.assembled, tuple(paths(given))
            yield PreparedBridge(
                scenario,
                case,
                files,
                tuple(known.notes),
                assembled,
                simulation,
                coupling,
                run,
                course,
                crossings,
            )


def _databases(can: CanBlock, folder: Path) -> DatabaseFiles:
    """The files of its databases."""
    given = can.database
    by_channel = given if isinstance(given, dict) else {ALL: given}
    return {
        str(channel): [folder / file for file in (files if isinstance(files, list) else [files])]
        for channel, files in by_channel.items()
    }


def _database(known: LogDatabase, number: int, path: Path) -> Database:
    database = known.of(number, "")
    if database is None:
        raise ScenarioError(f"{path}: can.database", f"has none of channel {number}", f"name one, or one of `{ALL}`")
    return database


def _can_block(scenario: Scenario) -> CanBlock:
    if scenario.can is None:
        raise ScenarioError(scenario.path, "has no `can` block", "say what is received and sent")
    if scenario.logger is not None:
        raise ScenarioError(
            scenario.path, "has a recorder, which samples a whole record", "remove it, and record the bus"
        )
    return scenario.can


def _case(scenario: Scenario, name: str | None) -> Case:
    for case in scenario.cases:
        if name in (None, case.name):
            return case
    known = ", ".join(case.name for case in scenario.cases)
    raise InputError(f"--case {name}", "there is no such case", f"choose {known}")


def _check_bus(bus: BusSettings, sent: Sequence[SentMessage], step: Fraction) -> None:
    """See that the bus can carry what is sent."""
    wider = [message.spec.name for message in sent if message.spec.fd]
    if wider and not bus.fd:
        raise InputError(bus.place, f"is no CAN FD bus, but {wider[0]} has CAN FD frames", "give --fd")
    if bus.bitrate is None:
        return
    load = sum(
        frame_time.seconds(
            message.spec.length, message.spec.extended, False, message.spec.fd, bus.bitrate, bus.data_bitrate
        )
        / float(message.every * step)
        for message in sent
    )
    if load > 1:
        raise InputError(
            bus.place,
            f"is too slow: what is sent needs {100 * load:.0f} % of {bus.bitrate} bit/s",
            "send less often, or give the bus a higher bit rate",
        )


def _course(
    job: BridgeJob, scenario: Scenario, simulation: Simulation, coupling: Coupling
) -> tuple[Course, dict[str, FloatArray]]:
    """How long to go on with which stimuli, and the first value of each input."""
    instants, driven = simulation.instants(), scenario.driven
    varying = [name for name in driven if scenario.stimuli[name].varies]
    columns = [scenario.stimuli[name].values(instants, name) for name in varying]
    first = {name: scenario.stimuli[name].values(instants[:1], name) for name in driven}
    if job.duration is not None:
        steps: int | None = multiples(job.duration, scenario.timing.step, "--duration")
    else:
        steps = None if job.stand_in else len(instants) - 1
    stimuli = np.column_stack(columns) if columns else np.zeros((1, 0))
    places = [driven.index(name) for name in varying]
    received = [signal.place for message in coupling.reception.messages for signal in message.signals]
    taken = [place for place in received if place < len(driven)]
    return Course(steps, job.stand_in, stimuli, places, taken, coupling.rules.give_up), first
