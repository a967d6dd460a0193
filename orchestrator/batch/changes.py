"""Which files of the suite a change touches: those that differ from a revision of git, or name one that does."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import fmus
from fmus import library
from fmus.errors import InputError, ScenarioError
from orchestrator.batch.dependencies import dependencies
from orchestrator.scenario.references import folder_of


@dataclass(frozen=True)
class Changes:
    """What differs from a revision.

    Attributes:
        root: the working tree.
        files: those whose content differs, that are new, or that are gone; absolute.
    """

    root: Path
    files: frozenset[Path]

    def touching(self, file: Path) -> list[Path]:
        """Those of the files that a file of the suite depends on: itself, what it names, its references; and those that
        git does not know."""
        try:
            needed = dependencies(file, self.files)
        except ScenarioError:  # of whatever kind it is, running the file tells
            needed = {file.resolve()}
        references = folder_of(file.resolve())
        found = {one for one in self.files if one in needed or one.parent == references}
        return sorted(found | {one for one in needed if self._is_unknown(one)})

    @property
    def own(self) -> list[Path]:
        """Files of servotwin itself among them, but models of its library: what these touch is not known."""
        packages = [
            Path(fmus.__file__).resolve().parents[1] / name for name in ("fmus", "orchestrator", "identification")
        ]
        return sorted(
            file
            for file in self.files
            if not library.holds(file) and any(package in file.parents for package in packages)
        )

    def _is_unknown(self, file: Path) -> bool:
        """Whether it lies outside the working tree; the library of an installed servotwin does not change."""
        return self.root not in file.parents and not library.holds(file)


def changes(revision: str, folder: Path) -> Changes:
    """What differs, in the working tree that a folder is in, from a revision.

    Raises:
        InputError: there is no git, no working tree, or no such revision.
    """
    root = Path(_git(folder, revision, "rev-parse", "--show-toplevel").rstrip("\n")).resolve()
    commit = _git(root, revision, "rev-parse", "--verify", "--end-of-options", f"{revision}^{{commit}}").strip()
    differ = _git(root, revision, "diff", "--name-only", "-z", "--no-renames", commit, "--")
    new = _git(root, revision, "ls-files", "-z", "--others")
    return Changes(root, frozenset(_resolved(root, [*differ.split("\0"), *new.split("\0")])))


def _resolved(root: Path, names: Iterable[str]) -> Iterable[Path]:
    return ((root / name).resolve() for name in names if name)


def _git(folder: Path, revision: str, *arguments: str) -> str:
    place = f"--changed {revision}"
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, check=False)
    except OSError:
        raise InputError(place, "git is not there", "install it, or leave out --changed") from None
    if done.returncode:
        said = (done.stderr.decode(errors="replace").strip() or "no answer").splitlines()[-1]
        raise InputError(place, f"git says '{said}'", "give a revision of the working tree that the files are in")
    return done.stdout.decode(errors="surrogateescape")
