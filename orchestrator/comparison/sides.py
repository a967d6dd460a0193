"""What can be compared: each side of a comparison as traces by case, whatever it is given as.

A side is a folder of results, a recording, a scenario, an FMU, or a way to run a scenario: packed as `native` or
`python` FMUs, stepped by the `compiled` loop or by `python-loop`, or with `half-step`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

from fmus.errors import InputError, ScenarioError
from orchestrator import formats
from orchestrator.assembly.assembly import SystemSpec, assemble
from orchestrator.comparison.fmu_side import alone, with_component
from orchestrator.comparison.result_traces import traces
from orchestrator.engine import Engine
from orchestrator.fmi.isolation import scratch
from orchestrator.progress import Progress, silent
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace

WHOLE = formats.Layout(texts=True)


@dataclass(frozen=True)
class SideSetting:
    """What sides that are FMUs, or ways to run, are run in.

    Attributes:
        scenario: the file; FMUs without one run alone.
        component: the one of its components that an FMU takes the place of; None where only one fits.
        case: the one case that is compared; None compares all.
        stop, step: of FMUs that run alone; None takes what they say themselves [s].
    """

    scenario: Path | None = None
    component: str | None = None
    case: str | None = None
    stop: float | None = None
    step: float | None = None


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a comparison.

    Attributes:
        cases: name -> what was recorded.
        notes: what is to be known of it, a line each.
    """

    name: str
    cases: Mapping[str, Trace]
    notes: tuple[str, ...] = field(default=())

    def renamed(self, names: Mapping[str, str]) -> Side:
        """The side with signals under other names (its own -> the other's).

        Raises:
            InputError: it has no such signal.
        """
        known = dict.fromkeys(name for trace in self.cases.values() for name in trace.names)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise InputError(self.name, f"has no signal '{unknown[0]}'", f"it holds {', '.join(known)}")
        return replace(self, cases={case: trace.renamed(names) for case, trace in self.cases.items()})


def _packed(target: str) -> Callable[[Scenario, Path], Scenario]:
    def way(scenario: Scenario, folder: Path) -> Scenario:
        systems = [group.system for group in scenario.by_system()]
        if all(component.fmu is not None for system in systems for component in system.components.values()):
            raise InputError(scenario.path, f"has no model that could be packed as {target}", "its components are FMUs")

        def packed(system: SystemSpec) -> SystemSpec:
            return assemble(system, folder / str(next(number)), scenario.driven, target).system

        number = count()
        return scenario.with_systems(packed)

    return way


def _stepped(engine: Engine) -> Callable[[Scenario, Path], Scenario]:
    return lambda scenario, _: replace(scenario, timing=replace(scenario.timing, engine=engine))


def _halved(scenario: Scenario, folder: Path) -> Scenario:
    return replace(scenario, timing=scenario.timing.finer(2))


WAYS: dict[str, Callable[[Scenario, Path], Scenario]] = {
    "native": _packed("native"),
    "python": _packed("python"),
    "compiled": _stepped(Engine.COMPILED),
    "python-loop": _stepped(Engine.PYTHON),
    "half-step": _halved,
}
"""Word -> what makes a scenario one that runs in that way; it may put FMUs into the folder."""


Comparable = str | Path | Trace | ScenarioResult
"""What a side may be given as: a path or a word of `WAYS`, a trace, what a run gave."""


def side(given: Comparable, setting: SideSetting, progress: Progress = silent) -> Side:
    """The side of a comparison that is given so.

    Raises:
        InputError: there is no such thing, or it cannot be compared.
        FmuError: an FMU failed.
    """
    if isinstance(given, Trace):
        return Side(given.name, {given.name: given})
    if isinstance(given, ScenarioResult):
        return Side(given.scenario.title, _traces(given, setting.case), _endings(given))
    return _of_path(str(given), setting, progress)


def _of_path(given: str, setting: SideSetting, progress: Progress) -> Side:
    path = Path(given)
    if given in WAYS:
        if setting.scenario is None:
            raise InputError(given, "is a way to run a scenario", "say which by --scenario FILE")
        return _run(given, setting.scenario, setting, WAYS[given], progress)
    if not path.exists():
        raise InputError(given, "is neither there nor one of " + ", ".join(WAYS), "check the path")
    if path.is_dir():
        cases = {name: trace for name, trace in traces(path).items() if setting.case in (None, name)}
        if not cases:
            which = f" of case {setting.case}" if setting.case else ""
            raise InputError(path, f"holds no trace{which}", "give a folder that `run` or `test` wrote")
        return Side(given, {name: formats.read(file, WHOLE).trace for name, file in cases.items()})
    if path.suffix.lower() == ".fmu":
        if setting.scenario is None:
            trace, notes = alone(path, setting.stop, setting.step)
            return Side(given, {path.stem: trace}, notes)

        def way(scenario: Scenario, folder: Path) -> Scenario:
            return scenario.with_systems(lambda system: with_component(system, path, setting.component))

        return _run(given, setting.scenario, setting, way, progress)
    if path.suffix in (".yaml", ".yml"):
        return _run(given, path, setting, lambda scenario, _: scenario, progress)
    recording = formats.read(path, WHOLE, progress)
    return Side(given, {path.stem: recording.trace}, recording.notes)


def _run(
    name: str, file: Path, setting: SideSetting, way: Callable[[Scenario, Path], Scenario], progress: Progress
) -> Side:
    scenario = load_scenario(file, references=False)
    cases = tuple(case for case in scenario.cases if setting.case in (None, case.name))
    if not cases:
        known = ", ".join(case.name for case in scenario.cases)
        raise ScenarioError(file, f"has no case '{setting.case}'", f"its cases are {known}")
    with scratch(None) as folder:
        made = way(replace(scenario, cases=cases), folder)
        result = run_scenario(made, progress=progress)
    return Side(name, _traces(result), _endings(result))


def _traces(result: ScenarioResult, only: str | None = None) -> dict[str, Trace]:
    cases = [case for case in result.cases if only in (None, case.name)]
    return {case.name: case.result.trace for case in cases if case.result is not None}


def _endings(result: ScenarioResult) -> tuple[str, ...]:
    refused = [f"case {case.name}: {case.error}" for case in result.cases if case.error is not None]
    return (*refused, *(f"case {case.name}: {case.ended}" for case in result.cases if case.ended))
