"""Commands that hold runs against something: accept, against references; compare, against each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import InputError
from orchestrator.cli.options import Isolate
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from orchestrator.comparison.comparison import Comparison, Tolerance
    from orchestrator.comparison.vocabulary import Acceptance

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
    from orchestrator.comparison.acceptance import document_of
    from orchestrator.comparison.vocabulary import FOLDER, accept_all

    found = accept_all(
        paths or [Path("scenarios")], out or Path(FOLDER), case, every, not dry, isolate.isolation(), terminal.bar
    )
    document = document_of(found.proposals, set() if dry else {new.file for new in found.written})
    for later in found.failures[1:]:
        terminal.say(str(later))
    unused = [*(file for proposal in found.proposals for file in proposal.unused), *found.abandoned]
    failure = found.failures[0] if found.failures else None
    shown = list(_accepted(found, dry))
    return Answer({**document, "unused": unused, "out": found.folder}, shown, failure=failure)


def _accepted(found: Acceptance, dry: bool) -> Iterator[Listing | str]:
    """What there is to say of it, for people."""
    from orchestrator.comparison.acceptance import HEADERS, drawn, rows, size

    if any(new.partings for new in found.references):
        yield Listing(HEADERS, [row for new in found.references for row in rows(new)], figures=True)
    yield from [drawing for new in found.references for drawing in drawn(new)][:DRAWN]
    word = "would be written" if dry else "written"
    for new in found.references:
        why = f" ({new.why})" if new.why else ""
        done = f", {word} ({size(new)})" if new in found.written else ""
        yield f"{new.file}: {new.change}{why}{done}"
    for proposal in found.proposals:
        yield from (f"warning: {proposal.scenario}: {line}" for line in proposal.doubts)
        yield from (f"unused: {file}, which no case asks for" for file in proposal.unused)
    yield from (f"unused: {one}, whose scenario is not there" for one in found.abandoned)
    page = found.folder / "report.html"
    yield f"curves in {page}" if found.references else "no case asks for `reference: accepted`"


@dataclass(frozen=True)
class Setting:
    """What things are compared in."""

    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What FMUs, or ways to run, are compared in.")
    ] = None
    component: Annotated[
        str | None, typer.Option(metavar="NAME", help="The component of the scenario that the FMUs take the place of.")
    ] = None
    case: Annotated[str | None, typer.Option(metavar="NAME", help="This case alone.")] = None


@dataclass(frozen=True)
class Tolerances:
    """By how much they may differ."""

    absolute: Annotated[float, typer.Option(min=0, help="Tolerance [unit of each signal] ...")] = 1e-9
    relative: Annotated[float, typer.Option(min=0, help="... or of its largest magnitude; the larger holds.")] = 1e-6
    within: Annotated[
        list[str] | None, typer.Option(metavar="SIGNAL=VALUE", help="Tolerance of one signal: 0.1, or '0.1 deg'.")
    ] = None

    def tolerance(self) -> Tolerance:
        """As the comparison takes them."""
        from orchestrator.comparison.comparison import Tolerance

        within = dict(_halves("--within", text) for text in self.within or [])
        return Tolerance(self.absolute, self.relative, within)


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
    setting: Setting,
    tolerances: Tolerances,
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
    from orchestrator.comparison.vocabulary import compare as compared
    from orchestrator.results import check_target

    files, tolerance = [Path(one), Path(other)], tolerances.tolerance()
    if out is not None:
        check_target(out, [path for path in files if path.exists()])
    names = dict(_halves("--pair", text)[::-1] for text in pair or [])
    found = compared(
        one, other, **vars(setting), tolerance=tolerance, names=names, stop=stop, step=step, bar=terminal.bar
    )
    shown = list(_compared(found, terminal.verbose > 0))
    if out is not None:
        telling.write(found, out, files)
        shown.append(f"curves in {out / 'report.html'}")
    return Answer(telling.document_of(found), shown, found.agree)


def _compared(found: Comparison, verbose: bool) -> Iterator[Listing | str]:
    """What there is to say of it, for people."""
    from orchestrator.comparison import telling
    from orchestrator.crossing import documents_of, notes

    yield from (f"note: {line}" for line in (*found.notes, *found.interface))
    if not verbose:  # the log has them, too
        yield from notes(documents_of(found.crossings))
    yield Listing(telling.HEADERS, list(telling.rows(found)), figures=True)
    yield from filter(None, [telling.drawn(found)])
    yield telling.sentence(found)


def _halves(option: str, text: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(f"{option} {text}", "has no value", "write SIGNAL=...")
    return name, value
