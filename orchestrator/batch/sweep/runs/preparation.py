"""From a study to all that its runs need: systems built, names and units looked up, points chosen, nothing run yet."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fmus import library
from fmus.errors import ScenarioError, ServotwinError
from fmus.files import RawMap, sha256
from fmus.modelling.model import Model
from fmus.words import listed
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.batch.sweep.points import resolving
from orchestrator.batch.sweep.points.choosing import chosen
from orchestrator.batch.sweep.points.designs import PointDesign
from orchestrator.batch.sweep.points.factors import Space, Target
from orchestrator.batch.sweep.points.resolving import FactorPlace
from orchestrator.batch.sweep.points.schema import MOST_RUNS, HypercubeBlock, SweepBlock, load_sweep
from orchestrator.batch.sweep.runs.reach import unseen
from orchestrator.batch.sweep.runs.rows import schema
from orchestrator.batch.sweep.runs.setup import Asked, Kept, Setup, Variant
from orchestrator.batch.sweep.runs.systems import Wired, wired
from orchestrator.rational import multiples, seconds
from orchestrator.scenario.expectations import Expected, OnSignal
from orchestrator.scenario.expectations.figure import Figure
from orchestrator.scenario.expectations.limits import Near, OneSided, Range
from orchestrator.scenario.expectations.reference import Follows
from orchestrator.scenario.scenario import Case
from orchestrator.settable import settable
from orchestrator.system import Endpoint, recordable


@dataclass(frozen=True)
class PreparedSweep:
    """A study that can be run.

    Attributes:
        file: the study's.
        identity: all that its rows depend on but how many points there are, by key; a folder has rows of one study.
        notes: what is to be known, a line each.
    """

    file: Path
    block: SweepBlock
    setup: Setup
    design: PointDesign
    identity: RawMap
    notes: Sequence[str]

    @property
    def scenario(self) -> Path:
        """The file that is swept."""
        return self.file.parent / self.block.sweep

    @property
    def runs(self) -> int:
        """How many there are."""
        return self.design.count * len(self.setup.cases)


@contextmanager
def prepared(file: Path) -> Iterator[PreparedSweep]:
    """A study that can be run while the block lasts; its FMUs are built for that.

    Raises:
        ScenarioError: the study does not fit itself or its scenario, or asks for too much.
        ServotwinError: what loading and building the scenario raises.
    """
    block = load_sweep(file)
    with tempfile.TemporaryDirectory(prefix="servotwin-") as folder:
        systems = wired(block, file, Path(folder))
        places = [FactorPlace(file, one.scenario, one.system) for one in systems]
        found = chosen(block, places)
        setup = _setup(block, file, found.space, systems)
        study = PreparedSweep(
            file, block, setup, found.design, _identity(block, file, systems), _notes(systems, setup.space)
        )
        _check_size(study)
        _check_seen(study, systems)
        _check_columns(study)
        yield study


def _setup(block: SweepBlock, file: Path, space: Space, systems: Sequence[Wired]) -> Setup:
    asked, places = _asked(systems)
    recordings, fmus = dict[int, tuple[Stimulus, ...]](), []
    for number, factor in enumerate(space.factors):
        if factor.target is Target.RECORDING:
            where = FactorPlace(file, systems[0].scenario, systems[0].system)
            recordings[number] = resolving.stimuli(block.vary[factor.name], where, factor.name)
        elif factor.target is Target.FMU:
            fmus.append((number, len(factor.words)))
    variants = tuple(
        Variant(one.assembled, one.scenario, one.cases, columns) for one, columns in zip(systems, places, strict=True)
    )
    names = {number: case.name for one in systems for number, case in zip(one.cases, one.scenario.cases, strict=True)}
    for name in block.noise:
        _check_seed(name, file, systems)
    return Setup(
        space,
        tuple(names[number] for number in range(len(names))),
        variants,
        asked,
        tuple(fmus),
        recordings,
        tuple(block.noise),
        getattr(block.design, "seed", 0),
        _kept(block, file, systems[0]),
    )


def _asked(systems: Sequence[Wired]) -> tuple[tuple[Asked, ...], list[tuple[tuple[int, ...], ...]]]:
    """The columns of figures, measures last; and for each system, case and expectation the number of its column."""
    expected: dict[str, Asked] = {}
    measures: dict[str, Asked] = {}
    for one in systems:
        for case in one.scenario.cases:
            own = _expected(case, one)
            for wanted in own:
                name = f"e{len(expected) + 1}"
                expected.setdefault(str(wanted), Asked(name, str(wanted), _unit(wanted, one)))
            for name, wanted in zip(one.measures, case.expected[len(own) :], strict=True):
                measures.setdefault(name, Asked(name, str(wanted), _unit(wanted, one), counts=False))
    numbers = {text: number for number, text in enumerate(expected)}
    last = [len(expected) + number for number in range(len(measures))]
    places = [
        tuple((*(numbers[str(wanted)] for wanted in _expected(case, one)), *last) for case in one.scenario.cases)
        for one in systems
    ]
    return (*expected.values(), *measures.values()), places


def _expected(case: Case, system: Wired) -> Sequence[Expected]:
    """What the scenario expects of a case."""
    return case.expected[: len(case.expected) - len(system.measures)]


def _unit(expected: Expected, system: Wired) -> str:
    """The unit of its figure; "" where that has none, or only a check knows it."""
    if not isinstance(expected, OnSignal):
        return ""
    unit = system.system.port(Endpoint.parse(expected.signal)).unit or ""
    if isinstance(expected.condition, Figure):
        return expected.condition.dimension.written(unit)
    return unit if isinstance(expected.condition, OneSided | Near | Range | Follows) else ""


def _kept(block: SweepBlock, file: Path, system: Wired) -> Kept | None:
    if block.traces is None:
        return None
    names, place = tuple(dict.fromkeys(block.traces.signals)), f"{file}: traces.signals"
    units = tuple(recordable(system.system, name, f"{place}: {name}").unit or "" for name in names)
    stride = 1
    if block.traces.every is not None:
        try:
            stride = multiples(seconds(block.traces.every), system.scenario.timing.step, "every")
        except ServotwinError as error:
            raise ScenarioError(f"{file}: traces.every", error.problem, error.fix) from None
    return Kept(names, units, stride)


def _check_seed(name: str, file: Path, systems: Sequence[Wired]) -> None:
    for one in systems:
        try:
            settable(one.system, f"{name}.seed")
        except ServotwinError as error:
            raise ScenarioError(f"{file}: noise: {name}", error.problem, "name components that have a `seed`") from None


def _check_size(study: PreparedSweep) -> None:
    if study.runs > MOST_RUNS:
        cases = f" in {len(study.setup.cases)} cases" if len(study.setup.cases) > 1 else ""
        problem = f"asks for {study.runs:,} runs, {study.design.count:,} points{cases}; {MOST_RUNS:,} are the most"
        raise ScenarioError(f"{study.file}: design", problem, "take fewer levels, or draw samples")
    if study.runs == 0:
        raise ScenarioError(f"{study.file}: design", "has no points", "give some")


def _check_seen(study: PreparedSweep, systems: Sequence[Wired]) -> None:
    """See that what varies can be noticed, with one of the systems at least."""
    kept = study.setup.kept.signals if study.setup.kept else ()
    names = [*study.setup.space.names, *(f"{name}.seed" for name in study.setup.noise)]
    for one in systems:
        looked_at = [signal for case in one.scenario.cases for signal in case.looked_at]
        names = unseen(one.system, names, [*looked_at, *kept], one.scenario.cases)
    if names:
        problem = "no expectation, measure or trace can see it"
        fix = "add an expectation to the scenario, or `measures` or `traces` to the study"
        raise ScenarioError(f"{study.file}: {names[0]}", problem, fix)
    if not (study.setup.asked or kept):
        raise ScenarioError(study.file, "nothing is kept of the runs", "give `measures` or `traces`")


def _check_columns(study: PreparedSweep) -> None:
    """See that no two columns of the rows have one name."""
    for name, count in Counter(schema(study.setup).names).items():
        if count > 1:
            place = f"{study.file}: measures.{name}" if name in study.block.measures else f"{study.file}: {name}"
            problem = f"would be {count} columns of the rows"
            raise ScenarioError(place, problem, "give the measure another name, or ask for it once")


def _notes(systems: Sequence[Wired], space: Space) -> list[str]:
    left_out = dict.fromkeys(text for one in systems for text in one.left_out)
    return [
        *(f"not judged, for it is no matter of the point: {text}" for text in left_out),
        *_over_cases(systems, space),
        *dict.fromkeys(note for one in systems for note in one.scenario.notes),
    ]


def _over_cases(systems: Sequence[Wired], space: Space) -> Iterator[str]:
    """A line about each parameter that varies and that differs from case to case in the scenario."""
    cases = [case for one in systems for case in one.scenario.cases]
    for factor in space.factors:
        own = {case.name: case.values[factor.name] for case in cases if factor.name in case.values}
        if len(set(own.values())) > 1:
            told = [f"{value} in {name}" for name, value in own.items()]
            yield f"{factor.name} varies, so its values in the cases do not count: {listed(told, between='; ')}"


def _identity(block: SweepBlock, file: Path, systems: Sequence[Wired]) -> RawMap:
    """What rows depend on, besides how many points there are; points themselves are compared with the rows."""
    document = block.model_dump(mode="json", exclude_none=True, exclude={"title", "description", "at_least"})
    design, asked = document["design"], block.design
    if isinstance(asked, HypercubeBlock):
        design["strata"] = asked.strata or asked.samples
    document["design"] = {key: one for key, one in design.items() if key not in ("samples", "trajectories", "points")}
    return document | {"files": _hashes(block, file, systems)}


def _hashes(block: SweepBlock, file: Path, systems: Sequence[Wired]) -> dict[str, str]:
    """Name -> SHA-256 of all files that rows depend on."""
    scenario = systems[0].scenario
    read = [scenario.path, *scenario.parts, *(one for files in scenario.recordings.values() for one in files)]
    read += [file.parent / one for factor in block.vary.values() for one in factor.files or ()]
    given = {spec.fmu for one in systems for spec in one.scenario.system.components.values()}
    read += [one for one in given if one is not None]
    read += [library.source_file(one) for one in _models(systems)]
    if block.calibration is not None:
        read.append(file.parent / block.calibration.folder / "summary.json")
    known = list(dict.fromkeys(path.resolve() for path in read))
    alike = Counter(path.name for path in known)
    told = {path: os.path.relpath(path, file.parent.resolve()) if alike[path.name] > 1 else path.name for path in known}
    return {name: sha256(path) for path, name in told.items()}


def _models(systems: Sequence[Wired]) -> list[Model]:
    """Those that components are made from."""
    specs = [spec for one in systems for spec in one.scenario.system.components.values() if spec.fmu is None]
    return [one.source if isinstance(one.source, Model) else library.find(str(one.source)) for one in specs]
