"""How every command talks: its common options, its answer as tables or one JSON document, its exit code."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from fmus.errors import InputError, ServotwinError
from orchestrator.cli.stdout import stdout_kept
from orchestrator.interrupts import Interrupts

WIDE = 120  # columns of output that goes to no terminal
OUT = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else WIDE)
ERR = Console(stderr=True, highlight=False, markup=False)

Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more; -vv shows tracebacks.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results.")]


@dataclass
class Answer:
    """What a command has to say: a document for machines, tables and lines for people, and whether all held.

    Attributes:
        interrupted: where an interrupt left something that is worth to be kept, a line about it.
    """

    document: dict[str, Any]
    shown: Sequence[Table | str] = ()
    held: bool = True
    interrupted: str = ""


@dataclass
class Terminal:
    """How to talk: chosen by --json, -q and -v."""

    json: bool = False
    quiet: bool = False
    verbose: int = 0

    @contextmanager
    def bar(self, label: str) -> Iterator[Callable[[float, str], None]]:
        """A progress bar on a terminal: the function that is given moves it to a fraction, with a remark."""
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[remark]}", markup=False),
            TimeElapsedColumn(),
        )
        hidden = self.quiet or self.json or not ERR.is_terminal
        with Progress(*columns, console=ERR, transient=True, disable=hidden) as progress:
            task = progress.add_task(label, total=1.0, remark="")

            def move(fraction: float, remark: str) -> None:
                progress.update(task, completed=fraction, remark=remark)

            yield move


def answered(work: Callable[[Terminal], Answer], as_json: bool, quiet: bool, verbose: int) -> None:
    """Do the work, show the answer, and leave with the exit code: 0, 1 (did not hold), 2, 3 or 130."""
    level = logging.ERROR if quiet else (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(
        level=level,
        format="%(message)s",
        force=True,
        handlers=[RichHandler(console=ERR, show_time=False, show_path=False)],
    )
    interrupts = Interrupts()
    try:
        with interrupts, stdout_kept():
            answer = work(Terminal(as_json, quiet, verbose))
    except ServotwinError as error:
        if interrupts.requested:
            _interrupted()
        _fail(error, error.exit_code, verbose)
    except KeyboardInterrupt:
        _interrupted()
    except OSError as error:
        _fail(InputError(error.filename or "file", error.strerror or str(error), "check the path"), 2, verbose)
    if as_json:
        sys.stdout.write(json.dumps(answer.document, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        for each in answer.shown:
            OUT.print(each, soft_wrap=isinstance(each, str))
    if answer.interrupted:
        _interrupted(answer.interrupted)
    raise typer.Exit(0 if answer.held else 1)


def _interrupted(line: str = "interrupted") -> NoReturn:
    ERR.print(line, soft_wrap=True)
    raise typer.Exit(130) from None


def _fail(error: ServotwinError, code: int, verbose: int) -> NoReturn:
    if verbose >= 2:
        ERR.print_exception()
    ERR.print(f"servotwin: {error}", style="red", soft_wrap=True, markup=False)
    raise typer.Exit(code) from None


def facts(document: dict[str, Any]) -> Table:
    """A document of one level of lists as a two-column table."""
    table = Table(show_header=False, title=str(document.get("name", "")))
    for key, value in document.items():
        if isinstance(value, list):
            for number, each in enumerate(value):
                cells = each.values() if isinstance(each, dict) else [each]
                table.add_row("" if number else key, "  ".join(str(cell) for cell in cells if cell not in (None, "")))
        elif key != "name":
            table.add_row(key, str(value))
    return table
