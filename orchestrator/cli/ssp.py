"""Commands on systems as other tools have them: ssp export, import, check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fmus.errors import InputError
from orchestrator.cli.terminal import Answer, Listing, Terminal, command

app = typer.Typer(no_args_is_help=True, help="Systems for other tools and from them, as .ssp.")


@command(app, "export")
def ssp_export(
    terminal: Terminal,
    scenario: Annotated[Path, typer.Argument(help="A scenario file, or an SSP.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="The SSP to write.")] = None,
    tool: Annotated[
        str, typer.Option("--for", help="any, or a tool with habits of its own: omsimulator, ecos, libcosim or fmpy.")
    ] = "any",
    version: Annotated[
        str, typer.Option("--ssp-version", metavar="VERSION", help="1.0, or 2.0: types and arrays of FMI 3.0.")
    ] = "1.0",
) -> Answer:
    """Write a scenario as an SSP, with its FMUs, values and all that belongs to it."""
    from orchestrator.scenario.exchange import export
    from orchestrator.ssp.names import Version
    from orchestrator.ssp.outline import Tool

    if tool not in list(Tool):
        raise InputError(f"--for {tool}", "is no tool that is known", f"choose {', '.join(Tool)}")
    if version not in list(Version):
        raise InputError(f"--ssp-version {version}", "is no version that is known", f"choose {', '.join(Version)}")
    file = out or Path("out") / f"{scenario.stem}.ssp"
    if file.suffix.lower() != ".ssp":
        raise InputError(f"--out {file}", "does not end in .ssp", "other tools know an SSP by its name")
    done = export(scenario, file, Tool(tool), Version(version))
    document = {
        "ssp": str(file),
        "version": version,
        "components": list(done.components),
        "connections": done.connections,
    }
    notes = [f"note: {line}" for line in done.notes]
    counted = f"{len(done.components)} components and {done.connections} connections in {file}"
    return Answer({**document, "notes": list(done.notes)}, [*notes, counted])


@command(app, "import")
def ssp_import(
    terminal: Terminal,
    ssp: Annotated[Path, typer.Argument(help="An SSP.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for the scenario.")] = None,
) -> Answer:
    """Write an SSP as a scenario file with its FMUs beside it."""
    from orchestrator.scenario.exchange import unpack
    from orchestrator.ssp.document import imported

    names = imported(ssp).names
    written = unpack(ssp, out or Path("out") / ssp.stem)
    document = {"scenario": str(written), "components": dict(names)}
    return Answer(document, [Listing(("component", "in the SSP"), list(names.items())), f"written to {written}"])


@command(app, "check")
def ssp_check(terminal: Terminal, ssp: Annotated[Path, typer.Argument(help="An SSP.")]) -> Answer:
    """See that an SSP is as the standard has it and fits together; exit code 1 where it is not valid."""
    from orchestrator.ssp.checking import check

    found = check(ssp)
    rows = [(one.file, one.problem) for one in found.problems]
    said = [*(f"note: {line}" for line in found.notes), f"{ssp}: SSP {found.version}, {len(rows)} problems"]
    shown: list[Listing | str] = [Listing(("file", "problem"), rows), *said] if rows else [*said]
    problems = [{"file": file, "problem": problem} for file, problem in rows]
    document = {"version": found.version, "problems": problems, "notes": list(found.notes)}
    return Answer(document, shown, held=not rows)
