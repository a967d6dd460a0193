"""Options that several commands have: other values and FMUs, isolation, runs in real time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmus.errors import InputError
from orchestrator.cli.terminal import Terminal

if TYPE_CHECKING:
    from orchestrator.bridge.preparation import BridgeJob
    from orchestrator.fmi.interface import Value
    from orchestrator.fmi.isolation import Isolation
    from orchestrator.live.panel import LivePanel
    from orchestrator.live.steering import Steering
    from orchestrator.progress import Progress
    from orchestrator.scenario.run import Execute


Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="COMP.PARAM=VALUE", help="Over the file's values.")
]


Fmus = Annotated[
    list[str] | None,
    typer.Option("--fmu", metavar="COMP=FILE", help="An FMU in place of a component, values and all."),
]


@dataclass(frozen=True)
class Isolate:
    """How FMUs are kept apart from this process; what a command isolates is one simulation, or an FMU in it."""

    isolate: Annotated[bool, typer.Option("--isolate", help="Run FMUs in processes that may crash and hang.")] = False
    patience: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="With --isolate: how long an answer may take; 60 by default."),
    ] = None

    def isolation(self) -> Isolation | None:
        """None when they are not."""
        from orchestrator.fmi.isolation import Isolation

        if self.isolate:
            return Isolation() if self.patience is None else Isolation(self.patience)
        if self.patience is not None:
            raise InputError("--patience", "is for isolated FMUs", "give --isolate, too")
        return None


@dataclass(frozen=True)
class LiveOptions:
    """What is shown and can be changed of a run in real time."""

    live: Annotated[
        bool, typer.Option("--live", help="In real time, with its signals on the terminal and keys that change values.")
    ] = False
    tune: Annotated[
        list[str] | None,
        typer.Option(
            "--tune", metavar="COMP.VARIABLE", help="With --live: what may be changed, by default all that can be."
        ),
    ] = None
    changes: Annotated[
        Path | None,
        typer.Option("--changes", metavar="FILE", help="With --live: lines COMP.VARIABLE=VALUE, whenever they change."),
    ] = None

    def steering(self, panel: LivePanel) -> Steering:
        """As the panel shows it."""
        from orchestrator.live.steering import Steering

        return Steering(None if self.tune is None else tuple(self.tune), self.changes, panel.begin, panel.move)

    @contextmanager
    def progress(self, terminal: Terminal, label: str) -> Iterator[tuple[Progress, Execute | None]]:
        """What is told how a run goes, and what runs it in real time where that is wanted."""
        if not self.live:
            with terminal.bar(label) as move:
                yield move, None
            return
        from orchestrator.live.paced import Paced
        from orchestrator.progress import silent

        with terminal.panel(label) as panel:
            yield silent, Paced(self.steering(panel)).execute

    @contextmanager
    def coupling(self, terminal: Terminal, job: BridgeJob) -> Iterator[tuple[BridgeJob, Progress]]:
        """A job that can be steered where that is wanted, and what is told how it goes."""
        if not self.live:
            with terminal.live(job.scenario.stem) as move:
                yield job, move
            return
        with terminal.panel(job.scenario.stem) as panel:
            yield replace(job, steering=self.steering(panel)), panel.move

    @contextmanager
    def steered(self, terminal: Terminal, label: str) -> Iterator[Steering]:
        """What may be changed of a run in real time, which is shown as it goes."""
        from orchestrator.live.steering import Steering

        if not self.live:
            with terminal.live(label) as move:
                yield Steering(progress=move)
            return
        with terminal.panel(label) as panel:
            yield self.steering(panel)

    def check(self) -> None:
        """See that the options go together.

        Raises:
            InputError: they do not.
        """
        for name, given in (("--tune", self.tune), ("--changes", self.changes)):
            if given is not None and not self.live:
                raise InputError(name, "is for runs in real time", "give --live, too")


def files(texts: list[str] | None) -> dict[str, Path]:
    """What the options --fmu say: component -> file."""
    named: dict[str, Path] = {}
    for text in texts or []:
        component, separator, file = text.partition("=")
        if not (component and separator and file):
            raise InputError(f"--fmu {text}", "is not COMP=FILE", "write --fmu controller=out/fmus/controller.fmu")
        _refuse_again(component, named, text, "--fmu")
        named[component] = Path(file)
    return named


def overrides(texts: list[str] | None) -> dict[str, Value | list[Any]]:
    """What the options --set say."""
    from orchestrator.scenario.run import parse_override

    named: dict[str, Value | list[Any]] = {}
    for text in texts or []:
        name, value = parse_override(text)
        _refuse_again(name, named, text, "--set")
        named[name] = value
    return named


def _refuse_again(name: str, named: Mapping[str, object], text: str, option: str) -> None:
    if name in named:
        raise InputError(f"{option} {text}", f"is the second {option} of '{name}'", "leave out one of them")
