"""How every command talks: its common options, its answer as tables or one JSON document, its exit code."""

from __future__ import annotations

import json
import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial
from inspect import Parameter, Signature, signature
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar, get_type_hints

import typer

from fmus.errors import InputError, ServotwinError, ours
from fmus.json_document import json_text
from orchestrator.display.plain import plain
from orchestrator.display.stdout import stdout_kept, unread, unwritable
from orchestrator.processes.interrupts import Interrupts, requested
from orchestrator.progress import Figures, Progress, silent, tell_ready
from orchestrator.results import Permission, permitted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.traceback import Traceback

    from orchestrator.live.panel import LivePanel

WIDE = 120  # columns of output that goes to no terminal
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results.")]
Force = Annotated[bool, typer.Option("--force", help="Replace what is in the folder, whatever it is.")]


@dataclass(frozen=True)
class Listing:
    """Rows for people.

    Attributes:
        figures: whether the columns between the first and the last hold figures.
    """

    headers: Sequence[str]
    rows: Iterable[Sequence[str]]
    title: str | None = None
    figures: bool = False


@dataclass(frozen=True)
class Answer:
    """What a command has to say: a document for machines, listings and lines for people, and whether all held.

    Attributes:
        interrupted: where an interrupt left something that is worth to be kept, a line about it.
        failure: where an error did, the error.
    """

    document: Mapping[str, object]
    shown: Sequence[Listing | str] = ()
    held: bool = True
    interrupted: str = ""
    failure: ServotwinError | None = None


@dataclass(frozen=True)
class Terminal:
    """How a command talks: the options that all have."""

    json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False
    verbose: Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more; -vv shows tracebacks.")] = 0

    def say(self, line: str) -> None:
        """Tell people something while the work goes on."""
        if not self.quiet:
            _err().print(plain(line), soft_wrap=True)
        tell_ready()

    @contextmanager
    def bar(self, label: str) -> Iterator[Progress]:
        """A progress bar on a terminal, moved by the function that is given."""
        if self.quiet or self.json or not _err().is_terminal:
            yield silent
            return
        from rich import progress

        columns = (
            progress.TextColumn("{task.description}", markup=False),
            progress.BarColumn(),
            progress.TextColumn("{task.fields[doing]}", markup=False),
            progress.TimeElapsedColumn(),
        )
        with progress.Progress(*columns, console=_err(), transient=True) as shown:
            task = shown.add_task(plain(label), total=1.0, doing="")
            yield lambda fraction, doing: shown.update(task, completed=fraction, doing=plain(doing))

    @contextmanager
    def panel(self, label: str) -> Iterator[LivePanel]:
        """What shows a run in real time and takes keys; without a terminal a line of JSON a second, or nothing."""
        from orchestrator.live.panel import LivePanel

        panel = LivePanel(label)
        if self.quiet or self.json or not _err().is_terminal:
            with self.live(label) as move:
                panel.also = move
                yield panel
            return
        with panel.shown(_err()):
            yield panel

    @contextmanager
    def live(self, label: str) -> Iterator[Progress]:
        """What shows how live work goes: a progress bar, or with --json a JSON line on stderr each second."""
        if not self.json or self.quiet:
            with self.bar(label) as move:
                yield move
            return
        told = -math.inf

        def tell(fraction: float, doing: str) -> None:
            nonlocal told
            if (now := monotonic()) - told >= 1.0:
                told = now
                figures = dict(doing.values) if isinstance(doing, Figures) else {"doing": doing}
                sys.stderr.write(json.dumps({"work": label, "fraction": round(fraction, 6)} | figures) + "\n")
                sys.stderr.flush()

        yield tell


Work = TypeVar("Work", bound=Callable[..., Answer])


def command(app: typer.Typer, name: str | None = None) -> Callable[[Work], Work]:
    """Make a function that is given a terminal and options, and returns the answer, a command.

    A parameter whose type is a dataclass stands for its fields, a group of options; --json, -q and -v come last, and
    where results go to a folder --force comes before them. The
    exit code is 0, 1 (did not hold), 2, 3, 4 (a fault of ours) or 130.
    """

    def register(work: Work) -> Work:
        terminal, *others = _evaluated(work)
        kinds: dict[str, Any] = {parameter.name: parameter.annotation for parameter in (*others, terminal)}
        groups: dict[str, Any] = {key: kind for key, kind in kinds.items() if is_dataclass(kind)}
        options = [_evaluated(groups[one.name]) if one.name in groups else [one] for one in (*others, terminal)]
        if Out in kinds.values():
            options.insert(-1, [Parameter("force", Parameter.KEYWORD_ONLY, default=False, annotation=Force)])

        def run(**given: Any) -> None:
            allowed = Permission(given.pop("force", False), tuple(_inputs(given)))
            for group, kind in groups.items():
                given[group] = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
            with permitted(allowed):
                _answered(partial(work, **given), given[terminal.name])

        run.__signature__ = Signature(list(chain(*options)))  # type: ignore[attr-defined]
        run.__doc__, run.__name__ = work.__doc__, work.__name__
        app.command(name)(run)
        return work

    return register


def _inputs(given: Mapping[str, Any]) -> Iterator[Path]:
    """The files and folders that a command is given to read."""
    for name, value in given.items():
        if name != "out":
            yield from (path for path in (value if isinstance(value, list) else [value]) if isinstance(path, Path))


def _evaluated(function: Callable[..., Any]) -> list[Parameter]:
    """The parameters of a function or dataclass, each by its keyword, with types instead of their texts."""
    hints = get_type_hints(function, include_extras=True)
    return [
        parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[parameter.name])
        for parameter in signature(function).parameters.values()
    ]


def _answered(work: Callable[[], Answer], terminal: Terminal) -> NoReturn:
    """Do the work, show the answer, and leave with the exit code."""
    _log(terminal)
    interrupts = Interrupts()
    try:
        with interrupts, stdout_kept():
            answer = work()
    except KeyboardInterrupt:
        _interrupted()
    except Exception as error:
        if interrupts.requested or requested():  # whoever met the interrupt has made another error of it
            _interrupted()
        _fail(ours(error), terminal, error)
    untold = _told(partial(_show_all, answer, terminal))
    if answer.interrupted or interrupts.requested:
        _interrupted(answer.interrupted or "interrupted")
    if answer.failure is not None:
        _fail(answer.failure, terminal, told=True)
    if untold is not None and answer.held:
        raise typer.Exit(untold.exit_code)
    raise typer.Exit(0 if answer.held else 1)


def _told(tell: Callable[[], object]) -> InputError | None:
    """Tell something on standard output; where it cannot be written, that is said, and returned."""
    try:
        tell()
        sys.stdout.flush()
    except BrokenPipeError:  # who reads has read enough
        unread("stdout")
    except OSError as problem:
        _say(error := unwritable(problem))
        return error
    return None


def _show_all(answer: Answer, terminal: Terminal) -> None:
    if terminal.json:
        sys.stdout.write(json_text(answer.document))
    elif not terminal.quiet:
        for shown in answer.shown:
            show(shown)


def _log(terminal: Terminal) -> None:
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    level = logging.ERROR if terminal.quiet else levels[min(terminal.verbose, 2)]
    logging.basicConfig(level=level, force=True, handlers=[_Log(level)])


class _Log(logging.Handler):
    """Log messages as rich shows them; it is loaded with the first one."""

    def emit(self, record: logging.LogRecord) -> None:
        self._shown().emit(record)

    @cache  # noqa: B019 - there is one
    def _shown(self) -> logging.Handler:
        from rich.logging import RichHandler

        handler = RichHandler(console=_err(), show_time=False, show_path=False)
        handler.setFormatter(_Plain("%(message)s"))
        return handler


class _Plain(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record))


def _interrupted(line: str = "interrupted") -> NoReturn:
    _err().print(plain(line), soft_wrap=True)
    raise typer.Exit(130) from None


def _fail(error: ServotwinError, terminal: Terminal, met: Exception | None = None, *, told: bool = False) -> NoReturn:
    """Leave with an error; `met` is the exception behind it, by default itself. With --json there is a document of it,
    unless an answer has been told."""
    if terminal.verbose >= 2:
        _err().print(_traceback(met or error))
    _say(error)
    if terminal.json and not told:
        failed = {"place": error.place, "problem": error.problem, "fix": error.fix, "exit_code": error.exit_code}
        _told(lambda: sys.stdout.write(json.dumps({"error": failed}, indent=2) + "\n"))
    raise typer.Exit(error.exit_code) from None


def _say(error: ServotwinError) -> None:
    _err().print(plain(f"servotwin: {error}"), style="red", soft_wrap=True, markup=False)


def _traceback(error: Exception) -> Traceback:
    from rich.traceback import Traceback

    return Traceback.from_exception(type(error), error, error.__traceback__)


def show(shown: Listing | str) -> None:
    """A line, or rows as a table, on standard output."""
    from rich import box, table

    console = _console(width=None if sys.stdout.isatty() else WIDE)
    if isinstance(shown, str):
        console.print(plain(shown), soft_wrap=True)
        return
    drawn = table.Table(title=plain(shown.title or "") or None, show_header=bool(shown.headers))
    if shown.figures:
        drawn.box, drawn.padding = box.SIMPLE_HEAD, (0, 1, 0, 0)
    for number, header in enumerate(shown.headers):
        right = shown.figures and 0 < number < len(shown.headers) - 1
        whole = shown.figures and number == 0
        drawn.add_column(plain(header), justify="right" if right else "left", overflow="fold", no_wrap=whole)
    for row in shown.rows:
        drawn.add_row(*map(plain, row))
    console.print(drawn)


@cache
def _err() -> Console:
    return _console(stderr=True)


def _console(**options: Any) -> Console:
    from rich.console import Console

    class Unending(Console):
        """Goes on without its reader, where rich would end the command."""

        def on_broken_pipe(self) -> None:
            self.quiet = True
            unread("stderr" if self.stderr else "stdout")

    return Unending(highlight=False, markup=False, emoji=False, **options)


def facts(document: Mapping[str, object]) -> Listing:
    """A document of one level of lists in two columns."""
    rows = []
    for key, value in document.items():
        if isinstance(value, list):
            for number, entry in enumerate(value):
                cells = entry.values() if isinstance(entry, dict) else [entry]
                rows.append(("" if number else key, "  ".join(str(cell) for cell in cells if cell not in (None, ""))))
        elif key != "name":
            rows.append((key, str(value)))
    return Listing((), rows, str(document.get("name", "")))
