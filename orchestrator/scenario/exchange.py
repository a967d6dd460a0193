"""A scenario as an SSP, and as a folder with a YAML file in which everything is beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmus.errors import InputError
from fmus.files import atomic_writes
from fmus.parameters.write_back import write_back
from orchestrator.assembly.assembly import Assembled, ComponentSpec, assemble
from orchestrator.assembly.whole_terminals import by_variables
from orchestrator.assembly.wiring import wire
from orchestrator.documents.sources import EXTRA, SCENARIO
from orchestrator.fmi.file import FmuDescription, FmuKind
from orchestrator.fmi.isolation import scratch
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import ScenarioBlock, load_scenario
from orchestrator.scenario.units import by_elements
from orchestrator.settable import typed
from orchestrator.ssp.annotations import kept
from orchestrator.ssp.names import Version
from orchestrator.ssp.outline import Outline, Times, Tool
from orchestrator.ssp.writing import write
from orchestrator.system import Part, System, component_values
from orchestrator.yaml_file import joined, text_of

_BUILT_IN = ("fmu", "model", "parameters", "tables")
_ELSEWHERE = ("include", "connections", "ssp")


@dataclass(frozen=True)
class ExportedScenario:
    """What was written.

    Attributes:
        components: those in it, each with the name of its FMU.
        notes: what other tools will do otherwise, a line each.
    """

    components: Mapping[str, str]
    connections: int
    notes: tuple[str, ...]


def export(file: Path, out: Path, tool: Tool = Tool.ANY, version: Version = Version.ONE) -> ExportedScenario:
    """Write a scenario as an SSP, with the FMUs of its components and all that it reads.

    Raises:
        InputError: the scenario does not fit, or the tool is not known to read this version; nothing is written.
    """
    if not tool.writes(version):
        known = f"what {tool} makes of an SSP is known for {Version.ONE} only"
        raise InputError(f"--ssp-version {version}", known, f"leave out --for, or write {Version.ONE}")
    scenario = load_scenario(file, references=False)
    if scenario.system.buses:
        raise InputError(f"{file}: buses", "an SSP has no buses between FMUs", "remove them, or hand on the scenario")
    with scenario.naming(), scratch(None) as folder:
        assembled = assemble(scenario.system, folder, scenario.driven)
        outline = replace(_outline(file, scenario, assembled), version=version)
        if tool is not Tool.ANY:
            outline = _with_defaults(outline, folder)
        notes = write(out, outline, tool)
    if any(case.system is not None for case in scenario.cases):
        notes.append("components that cases have of their own are known here only")
    if any(asked.accepted for case in scenario.cases for asked in case.expected):
        notes.append(f"accepted references stay behind; `servotwin accept {out}` takes its own")
    files = {name: path.name for name, path in outline.files.items()}
    return ExportedScenario(files, len(outline.system.links), tuple(notes))


def unpack(file: Path, out: Path) -> Path:
    """Write a scenario, as an SSP or any other, into a folder: a YAML file, and beside it all that it names.

    Raises:
        InputError: it does not fit; nothing is written.
    """
    document, places = joined(file, ScenarioBlock)
    load_scenario(file, references=False)
    document.pop("include", None)
    target = out / f"{file.stem}.yaml"
    if target.exists():
        raise InputError(target, "is there already", "give --out another folder, or move it away")
    packed = _packed(places, file.parent, {".fmu": "fmus"})
    atomic_writes({**{out / name: content for name, content in packed.items()}, target: text_of(document)})
    return target


def _outline(file: Path, scenario: Scenario, assembled: Assembled) -> Outline:
    descriptions = {
        name: FmuDescription(assembled.files[name], _kind(component), component.parameters)
        for name, component in assembled.system.components.items()
    }
    parts = {name: Part(described.interface) for name, described in descriptions.items()}
    system = wire(parts, by_variables(assembled.system.connections, parts, assembled.files), scenario.driven)
    times = Times(float(scenario.timing.start), float(scenario.timing.stop), float(scenario.timing.step))
    values = {name: value for name, value in assembled.system.values().items() if name not in scenario.driven}
    return Outline(
        name=file.stem,
        description=scenario.title,
        system=system,
        files=assembled.files,
        kinds={name: described.kind for name, described in descriptions.items()},
        values=typed(system, values),
        times=times,
        driven=_driven(scenario, system),
        recorded=tuple(
            dict.fromkeys(name for name in by_elements(system, scenario).record or () if _is_output(system, name))
        ),
        annotations=_annotations(file),
        others=_extras(file),
    )


def _with_defaults(outline: Outline, folder: Path) -> Outline:
    """The same with FMUs that have their values as defaults, where they are ours: tools that do not take some kind of
    value from an SSP then have it all the same."""
    files = dict(outline.files)
    for name, file in outline.files.items():
        own = component_values(name, outline.values)
        if own and FmuDescription(file).is_ours:
            files[name] = folder / "defaults" / f"{name}.fmu"
            write_back(file, own, files[name])
    return replace(outline, files=files)


def _kind(component: ComponentSpec) -> FmuKind | None:
    return FmuKind.MODEL_EXCHANGE if component.solver else None


def _driven(scenario: Scenario, system: System) -> dict[str, float | None]:
    """What drives inputs, in their units; None where it changes in time."""
    driven: dict[str, float | None] = {}
    for name, stimulus in scenario.stimuli.items():
        component, _, variable = name.partition(".")
        brought, _ = stimulus.brought(name, system.parts[component].interface.ports[variable])
        driven[name] = None if brought.varies else float(brought.source)  # type: ignore[arg-type]
    return driven


def _is_output(system: System, name: str) -> bool:
    component, _, variable = name.partition(".")
    port = system.parts[component].interface.ports.get(variable) if component in system.parts else None
    return port is not None and port.causality == "output"


def _annotations(file: Path) -> dict[str, list[bytes]]:
    """Those of the description that a scenario was imported from."""
    described = joined(file, ScenarioBlock)[0].get("ssp")
    return {} if described is None else kept(file.parent / described)


def _extras(file: Path) -> dict[str, bytes]:
    """What a description of a system cannot say: the rest of the scenario, and the files that it names."""
    document, places = joined(file, ScenarioBlock)
    components = document.get("components", {})
    in_system = [id(component) for component in components.values()]
    tables = [id(block) for one in components.values() for block in one.get("tables", {}).values()]
    places = [
        (holder, key)
        for holder, key in places
        if id(holder) not in (*in_system, *tables) and not (holder is document and key in _ELSEWHERE)
    ]
    packed = _packed(places, file.parent, {})
    for name, component in components.items():
        components[name] = {key: value for key, value in component.items() if key not in _BUILT_IN}
    rest = {key: value for key, value in document.items() if key not in _ELSEWHERE}
    return {SCENARIO: text_of(rest), **{f"{EXTRA}/{name}": content for name, content in packed.items()}}


def _packed(places: list[tuple[Any, Any]], base: Path, folders: Mapping[str, str]) -> dict[str, bytes]:
    """Name -> contents of the files that a document names, which is changed to name them so.

    Args:
        folders: suffix -> folder of files that end so; the others go into `files`.
    """
    contents: dict[str, bytes] = {}
    names: dict[Path, str] = {}
    for holder, key in places:
        source = (base / holder[key]).resolve()
        if source not in names:
            if not source.is_file():
                raise InputError(source, "is not there", "correct the scenario")
            folder = folders.get(source.suffix.lower(), "files")
            name, number = f"{folder}/{source.name}", 2
            while name in contents:
                name, number = f"{folder}/{source.stem}-{number}{source.suffix}", number + 1
            names[source], contents[name] = name, source.read_bytes()
        holder[key] = names[source]
    return contents
