"""Commands that make FMUs and run scenarios: build, run; and info."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmus.errors import InputError
from orchestrator.cli.options import Fmus, Isolate, LiveOptions, Overrides, files, overrides
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command
from orchestrator.cli.traces import described
from orchestrator.processes.interrupts import whole

if TYPE_CHECKING:
    from fmus.modelling.model import Model
    from orchestrator.engine import RunProfile
    from orchestrator.fmi.interface import Value
    from orchestrator.fmi.isolation import Isolation
    from orchestrator.network.export import ExportedNetwork
    from orchestrator.progress import Progress
    from orchestrator.scenario.run import Execute, ScenarioResult
    from orchestrator.scenario.scenario import Scenario

app = typer.Typer()


@command(app)
def build(
    terminal: Terminal,
    models: Annotated[
        list[str] | None, typer.Argument(help="Models of the library, or model files; all by default.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="native: generated C (default where there is a C compiler); python: run by pythonfmu."),
    ] = None,
    fmi: Annotated[int, typer.Option(help="FMI version, 2 or 3.")] = 2,
    platform: Annotated[
        list[str] | None, typer.Option(help="Of native FMUs: host, all, x86_64-linux, aarch64-darwin, ...; repeatable.")
    ] = None,
    from_sources: Annotated[
        bool, typer.Option("--from-sources", help="The arguments are FMU files: compile the sources that they bring.")
    ] = False,
    system: Annotated[
        Path | None, typer.Option("--system", metavar="SCENARIO", help="Its system as one native FMU, steps and all.")
    ] = None,
    expose: Annotated[
        list[str] | None,
        typer.Option(
            "--expose", metavar="COMP.PARAM", help="With --system: parameters to show, * and ? allowed; all by default."
        ),
    ] = None,
    bus: Annotated[
        Path | None,
        typer.Option("--bus", metavar="FILE.dbc", help="With --fmi 3: as network FMUs (FMI-LS-BUS) on this CAN bus."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the FMUs.")] = None,
) -> Answer:
    """Build FMUs from model files, from the sources that FMUs bring along, or of a whole system."""
    folder, platforms = out or Path("out/fmus"), platform or ["host"]
    if bus is not None and (system is not None or from_sources or not models):
        raise InputError("--bus", "is for models that are named", "servotwin build MODEL --fmi 3 --bus FILE.dbc")
    if system is not None:
        if models or from_sources or target == "python":
            other = "--from-sources" if from_sources else "--target python" if target else models and models[0]
            raise InputError("--system", f"does not go with {other}", "servotwin build --system SCENARIO")
        return _of_system(terminal, system, expose or [], fmi, platforms, folder)
    if expose:
        raise InputError("--expose", "says what the FMU of a system shows", "give --system SCENARIO, too")
    if from_sources:
        if not models or target is not None:
            raise InputError("--from-sources", "is for FMU files alone", "servotwin build --from-sources FILE.fmu")
        return _compiled(terminal, [Path(model) for model in models], platforms, folder)
    return _of_models(terminal, models, target, fmi, platforms, bus, folder)


def _of_models(
    terminal: Terminal,
    names: list[str] | None,
    target: str | None,
    fmi: int,
    platforms: list[str],
    bus: Path | None,
    out: Path,
) -> Answer:
    """An FMU of each model."""
    from fmus import library
    from fmus.packaging import targets

    chosen = [library.find(name) for name in names or library.names()]
    packaging = target or targets.preferred()
    files = {model.name: out / f"{model.name}.fmu" for model in chosen}
    buses = {} if bus is None else _on_bus(chosen, bus)
    with terminal.bar("building") as move:
        for number, model in enumerate(chosen):
            move(number / len(chosen), model.name)
            network = buses[model.name].network if buses else None
            targets.build(model, files[model.name], target=packaging, fmi=fmi, platforms=platforms, network=network)
    rows = [(model.name, str(files[model.name]), model.description) for model in chosen]
    document: dict[str, object] = {"fmus": files, "target": packaging, "fmi": fmi}
    notes = [f"{name}: {note}" for name, found in buses.items() for note in found.notes]
    if buses:
        document["buses"] = {name: found.document() for name, found in buses.items()}
    return Answer(document, [Listing(("model", "FMU", "description"), rows), *notes])


def _on_bus(models: Sequence[Model], bus: Path) -> dict[str, ExportedNetwork]:
    """What each model exchanges over a bus."""
    from orchestrator.crossing import logged
    from orchestrator.network.export import exported

    found = {model.name: exported(model, bus) for model in models}
    logged([crossing for made in found.values() for crossing in made.crossings])
    return found


def _of_system(
    terminal: Terminal, scenario: Path, expose: list[str], fmi: int, platforms: list[str], out: Path
) -> Answer:
    """A scenario's system as one FMU."""
    from orchestrator.scenario.fusing import build, fuse

    with terminal.bar("building") as move:
        fused = fuse(scenario, expose)
        move(0.5, fused.system.name)
        file = build(fused, out, fmi, platforms)
    system = fused.system
    rows = [(name, part.title, f"{float(part.every * system.base):.9g}") for name, part in system.parts.items()]
    document = {
        "fmus": {system.name: str(file)},
        "target": "native",
        "fmi": fmi,
        "base_step": float(system.base),
        "parts": [{"name": name, "model": model, "step": float(step)} for name, model, step in rows],
        "parameters": list(system.parameters),
        "outputs": list(system.outputs),
        "notes": list(fused.notes),
    }
    summary = f"{file}: steps are multiples of {float(system.base):.9g} s"
    return Answer(document, [summary, Listing(("part, in stepping order", "model", "step [s]"), rows), *fused.notes])


def _compiled(terminal: Terminal, originals: list[Path], platforms: list[str], out: Path) -> Answer:
    """FMUs with what their own sources were compiled to."""
    from fmus.packaging import cache
    from fmus.packaging.native import foreign_sources

    rows, notes = [], {}
    with terminal.bar("compiling") as move:
        for number, file in enumerate(originals):
            move(number / len(originals), file.name)
            notes[str(file)] = found = foreign_sources.build(file, out / file.name, platforms)
            rows.append((str(file), str(out / file.name), "; ".join(found)))
    document = {"fmus": {file: made for file, made, _ in rows}, "notes": notes, "platforms": platforms}
    kept = cache.current() is not None and {"host", "all"} & set(platforms)
    said = ["files that bring no binary for this platform now run as they are, too"] if kept else []
    return Answer(document, [Listing(("file", "FMU", "notes"), rows), *said])


@command(app)
def run(
    terminal: Terminal,
    scenario: Annotated[Path, typer.Argument(help="A scenario file, or an SSP.")],
    *,
    out: Out = None,
    set_: Overrides = None,
    fmu: Fmus = None,
    stride: Annotated[int, typer.Option(min=1, metavar="N", help="Record, and judge, every N-th step only.")] = 1,
    stream: Annotated[bool, typer.Option("--stream", help="Write the record to its file while running.")] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Write profile.json, all steps as a trace for Perfetto or Chrome.")
    ] = False,
    check_step: Annotated[
        bool,
        typer.Option(
            "--check-step", help="Run with a half and a quarter of the step, too: each signal's error, and its order."
        ),
    ] = False,
    isolate: Isolate,
    live: LiveOptions,
) -> Answer:
    """Run one scenario; exit code 1 when an expectation fails."""
    from orchestrator.engine import RunProfile
    from orchestrator.results import check_target, default_folder
    from orchestrator.scenario.schema import load_scenario

    values, isolation, folder = overrides(set_), isolate.isolation(), out or default_folder(scenario)
    live.check()
    if check_step and live.live:
        raise InputError("--check-step", "is not for runs in real time", "leave --live out")
    check_target(folder)
    with live.progress(terminal, scenario.stem) as (move, execute):
        how = Running(values, stride, stream, RunProfile() if profile else None, execute, isolation)
        loaded = load_scenario(scenario, fmus=files(fmu))
        answer, result = run_and_write(terminal, loaded, folder, how, move)
    whole_run = not result.interrupted and answer.failure is None
    return _with_step_errors(answer, terminal, loaded, result, isolation) if check_step and whole_run else answer


@dataclass(frozen=True)
class Running:
    """How a scenario is run, and what is kept of it; see `Keeping` and `run_scenario`."""

    values: Mapping[str, Value | list[Any]]
    stride: int = 1
    stream: bool = False
    profile: RunProfile | None = None
    execute: Execute | None = None
    isolation: Isolation | None = None


def run_and_write(
    terminal: Terminal, loaded: Scenario, folder: Path, how: Running, move: Progress
) -> tuple[Answer, ScenarioResult]:
    """What came of a scenario, written to a folder that may be written to, and the answer to whoever asked."""
    from orchestrator.crossing import notes
    from orchestrator.fmi.said import LOG_FILE
    from orchestrator.results import aside
    from orchestrator.scenario.report import interruption
    from orchestrator.scenario.results import document_of, write_run
    from orchestrator.scenario.run import HEADERS, Keeping, ScenarioFailed, ScenarioInterrupted, run_scenario

    failure: ScenarioFailed | None = None
    with aside(folder) as near:
        keeping = Keeping(how.stride, near if how.stream else None, near / LOG_FILE, how.profile, how.execute)
        try:
            result = run_scenario(loaded, how.values, move, keeping=keeping, isolation=how.isolation)
        except ScenarioInterrupted as stop:
            result = stop.result
        except ScenarioFailed as error:
            result, failure = error.result, error
        with whole():
            write_run(result, {}, folder)
        document = document_of(result, {}, folder)
    for line in result.scenario.held:
        terminal.say(f"note: {line}")
    for line in notes(document["units"]) if not terminal.verbose else ():  # the log has them, too
        terminal.say(line)
    if result.interrupted:
        line = f"{interruption(result)}; the result up to there is in {folder}"
        return Answer(document, held=False, interrupted=line), result
    checks = Listing(HEADERS, result.rows(), result.scenario.title)
    shown: list[Listing | str] = [checks, f"results in {folder}"]
    if terminal.verbose:
        shown[1:1] = _step_statistics(result)
    return Answer(document, shown, result.passed, failure=failure), result


def _step_statistics(result: ScenarioResult) -> list[Listing | str]:
    """What the steps of all cases took."""
    from orchestrator.scenario import accounts

    rows = [
        (name, f"{calls:,}", f"{seconds:.3g}", f"{microseconds:.3g}", f"{share:.1f}")
        for name, calls, seconds, microseconds, share in accounts.rows_of(result)
    ]
    return [Listing(accounts.HEADERS, rows, "Step statistics, all cases"), accounts.sentence_of(result)]


def _with_step_errors(
    answer: Answer, terminal: Terminal, scenario: Scenario, result: ScenarioResult, isolation: Isolation | None
) -> Answer:
    """The answer with what the length of the steps costs each signal."""
    from orchestrator.scenario.step_check import HEADERS, step_errors

    with terminal.bar("shorter steps") as move:
        errors = step_errors(scenario, result, move, isolation)
    listing = Listing(
        HEADERS, [error.row() for error in errors if error.difference], "Errors by the communication step"
    )
    same = sum(not error.difference for error in errors)
    lines = [f"{same} of {len(errors)} signals are the same with half the step"] if same else []
    for name in dict.fromkeys(error.signal for error in errors if error.unsettled):
        cases = ", ".join(error.case for error in errors if error.unsettled and error.signal == name)
        lines.append(f"{name} ({cases}): the difference does not fall with the step as an error does; try shorter ones")
    document = {**answer.document, "steps": errors}
    return replace(answer, document=document, shown=[*answer.shown, listing, *lines])


@command(app)
def info(
    terminal: Terminal,
    file: Annotated[Path, typer.Argument(help="An FMU, an SSP, a trace, or a folder of results.")],
    tree: Annotated[bool, typer.Option("--tree", help="What FMUs are inside of an FMU or an SSP.")] = False,
) -> Answer:
    """What an FMU, an SSP, a trace or a result holds."""
    if tree:
        from fmus.json_document import document_of
        from orchestrator.ssp import tree as trees

        inside = trees.tree(file)
        return Answer(document_of(inside), list(inside.lines()))
    from orchestrator.info import about

    document = about(file)
    return Answer(document, list(described(document)))
