"""Options that choose, of the files of the suite, those to run: what failed last time, or what a change touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.terminal import Terminal

if TYPE_CHECKING:
    from orchestrator.batch.discovery import SuiteFile


@dataclass(frozen=True)
class FileSelection:
    """Which files are run; all of them by default."""

    failed: Annotated[bool, typer.Option("--failed", help="Only those that failed last time.")] = False
    changed: Annotated[
        str | None,
        typer.Option(metavar="REV", help="Only those that depend on a file that differs from this git revision."),
    ] = None

    @property
    def nothing(self) -> str:
        """Why no file may be left, in words."""
        why = ["none failed the last time"] if self.failed else []
        return " or ".join(why + ([f"none depends on what differs from {self.changed}"] if self.changed else []))

    def of(self, tasks: Sequence[SuiteFile], out: Path, terminal: Terminal) -> list[SuiteFile]:
        """Those of the tasks; what a change touches is said.

        Raises:
            InputError: nothing has run into the folder yet, or there is no such revision.
        """
        chosen = list(tasks)
        if self.failed:
            from orchestrator.batch.history import failed

            files = set(failed([task.file for task in chosen], out))
            chosen = [task for task in chosen if task.file in files]
        if self.changed is not None:
            chosen = _touched(self.changed, chosen, terminal)
        return chosen


def _touched(revision: str, tasks: Sequence[SuiteFile], terminal: Terminal) -> list[SuiteFile]:
    from orchestrator.batch.changes import Changes, changes

    trees: dict[Path, Changes] = {}  # folder -> what differs in its working tree
    touched = []
    for task in tasks:
        folder = task.file.resolve().parent
        if folder not in trees:
            known = next((tree for tree in trees.values() if tree.root in (folder, *folder.parents)), None)
            trees[folder] = known or changes(revision, folder)
        if files := trees[folder].touching(task.file):
            touched.append(task)
            if terminal.verbose:
                terminal.say(f"{task.file} depends on {', '.join(map(str, files))}")
    own = sorted({file for tree in trees.values() for file in tree.own})
    if own:
        terminal.say(
            f"note: {len(own)} files of servotwin itself differ from {revision}, such as {own[0].name}; what these "
            "touch is not known: run all without --changed"
        )
    return touched
