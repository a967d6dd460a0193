"""Commands that hold runs against something: accept, against references; compare, against each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import InputError, ServotwinError
from orchestrator.cli.scenarios import Isolate
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from orchestrator.comparison.proposal import Proposal

app = typer.Typer()
DRAWN = 6  # signals at most


@command(app)
def accept(
    terminal: Terminal,
    *,
    paths: Annotated[list[Path] | None, typer.Argument(help="Scenarios and folders; scenarios/ by default.")] = None,
    case: Annotated[str | None, typer.Option(metavar="NAME", help="Of one scenario this case alone.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Write also those that agree with the old ones.")] = False,
    dry: Annotated[bool, typer.Option("--dry-run", help="Show what would be written, and write none.")] = False,
    out: Out = None,
    isolate: Isolate,
) -> Answer:
    """Run scenarios that ask for accepted references, show new against old ones, and write those that differ.

    The folder of results has a page with the curves and the references that were replaced.
    """
    from orchestrator.batch.discovery import find_scenarios
    from orchestrator.batch.scenario_judge import ScenarioJudge
    from orchestrator.comparison.acceptance import HEADERS, accept, document_of, drawn, rows, size
    from orchestrator.comparison.proposal import propose
    from orchestrator.results import check_target
    from orchestrator.scenario.references import abandoned

    judge = ScenarioJudge()
    tasks = find_scenarios(paths or [Path("scenarios")], {}, judge)
    files = [task.file for task in tasks if task.judge is judge]
    if case is not None and len(files) != 1:
        raise InputError("--case", "is for one scenario", f"give one of {', '.join(map(str, files))}")
    folder = out or Path("out/accept")
    check_target(folder, files)
    proposals: list[Proposal] = []
    failures: list[ServotwinError] = []
    for file in files:
        with terminal.bar(file.stem) as move:
            try:
                proposals.append(propose(file, case, move, isolate.isolation()))
            except ServotwinError as error:
                failures.append(error)
    chosen = accept(proposals, folder, every, not dry)
    made = [new for proposal in proposals for new in proposal.references]
    shown: list[Listing | str] = []
    if any(new.partings for new in made):
        shown.append(Listing(HEADERS, [row for new in made for row in rows(new)], figures=True))
    shown += [drawing for new in made for drawing in drawn(new)][:DRAWN]
    word = "would be written" if dry else "written"
    for new in made:
        why = f" ({new.why})" if new.why else ""
        shown.append(f"{new.file}: {new.change}{why}{f', {word} ({size(new)})' if new in chosen else ''}")
    for proposal in proposals:
        shown += [f"warning: {proposal.scenario}: {line}" for line in proposal.doubts]
        shown += [f"unused: {file}, which no case asks for" for file in proposal.unused]
    gone = [one for place in sorted({file.parent for file in files}) for one in abandoned(place)]
    shown += [f"unused: {one}, whose scenario is not there" for one in gone]
    shown.append(f"curves in {folder / 'report.html'}" if made else "no case asks for `reference: accepted`")
    document = document_of(proposals, set() if dry else {new.file for new in chosen})
    for failure in failures[1:]:
        terminal.say(str(failure))
    unused = [*document["unused"], *map(str, gone)]
    return Answer({**document, "unused": unused, "out": str(folder)}, shown, failure=failures[0] if failures else None)


@command(app)
def compare(
    terminal: Terminal,
    one: Annotated[
        str,
        typer.Argument(
            metavar="A",
            help="A folder of results, a recording, a scenario, an FMU; or, with --scenario, a way to run it: "
            "native or python FMUs, compiled or python-loop, half-step.",
        ),
    ],
    other: Annotated[str, typer.Argument(metavar="B", help="What it is held against, of any of these kinds.")],
    *,
    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What FMUs, or ways to run, are compared in.")
    ] = None,
    component: Annotated[
        str | None, typer.Option(metavar="NAME", help="The component of the scenario that the FMUs take the place of.")
    ] = None,
    case: Annotated[str | None, typer.Option(metavar="NAME", help="This case alone.")] = None,
    absolute: Annotated[float, typer.Option(min=0, help="Tolerance [unit of each signal] ...")] = 1e-9,
    relative: Annotated[float, typer.Option(min=0, help="... or of its largest magnitude; the larger holds.")] = 1e-6,
    within: Annotated[
        list[str] | None, typer.Option(metavar="SIGNAL=VALUE", help="Tolerance of one signal: 0.1, or '0.1 deg'.")
    ] = None,
    pair: Annotated[
        list[str] | None, typer.Option(metavar="SIGNAL=SIGNAL", help="A signal of A, and what it is called in B.")
    ] = None,
    stop: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FMUs alone, over their own.")] = None,
    step: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FMUs alone, over their own.")] = None,
    out: Out = None,
) -> Answer:
    """Hold two things against each other: where they part first, in what signal, and by what.

    Exit code 1 when they part beyond the tolerance.
    """
    from orchestrator.comparison import telling
    from orchestrator.comparison.comparison import Tolerance
    from orchestrator.comparison.comparison import compare as compared
    from orchestrator.comparison.fmu_side import differences
    from orchestrator.comparison.sides import Setting, side
    from orchestrator.results import check_target, result_folder, versions, write_json

    tolerance = Tolerance(absolute, relative, dict(_halves("--within", text) for text in within or []))
    names = dict(_halves("--pair", text)[::-1] for text in pair or [])
    setting = Setting(scenario, component, case, stop, step)
    if out is not None:
        check_target(out, [path for path in (Path(one), Path(other)) if path.exists()])
    sides = []
    for given in (one, other):
        with terminal.bar(given) as move:
            sides.append(side(given, setting, move))
    found = compared(sides[0], sides[1].renamed(names), tolerance)
    files = [Path(given) for given in (one, other)]
    fmus = all(file.suffix.lower() == ".fmu" for file in files)
    interface = differences(files[0], files[1]) if fmus else []
    document = {**telling.document_of(found), "interface": interface}
    shown: list[Listing | str] = [f"note: {line}" for line in (*found.notes, *interface)]
    shown.append(Listing(telling.HEADERS, list(telling.rows(found)), figures=True))
    shown += [drawing] if (drawing := telling.drawn(found)) else []
    shown.append(telling.sentence(found))
    if out is not None:
        with result_folder(out, files) as folder:
            write_json(folder / "manifest.json", {"title": "Comparison", **document, "versions": versions()})
            telling.page(found).write(folder / "report.html")
        shown.append(f"curves in {out / 'report.html'}")
    return Answer(document, shown, found.agree)


def _halves(option: str, text: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(f"{option} {text}", "has no value", "write SIGNAL=...")
    return name, value
