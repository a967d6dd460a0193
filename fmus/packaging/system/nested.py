"""An FMU within the FMU of a system, in plain values: what of it the system uses, and its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from fmus.errors import ModelError
from fmus.modelling.model import Number, Table
from fmus.packaging import archive
from fmus.packaging.description.interface import Exposed
from fmus.packaging.native.compiler import Platform

BINARIES = "binaries/"


@dataclass(frozen=True)
class NestedVariable:
    """A variable of an FMU within a system.

    Attributes:
        shown: as the system describes it, by its name in its own FMU; the value reference is its place in the part.
        reference: its value reference in its own FMU.
        kind: of its values there, as nested.h calls it.
        size: how many values are behind it: all of an array behind its first element, none behind the others, which
            follow it.
    """

    shown: Exposed
    reference: int
    kind: str
    size: int = 1


@dataclass(frozen=True)
class NestedPart:
    """An FMU in a system.

    Attributes:
        place: the file that it comes from, for messages.
        title: name of its model.
        fmi: 2 or 3.
        variables: those that the system sets or reads, inputs all of them.
        values: of inputs and parameters that are set in it; the others have what they have in the FMU.
        feed_through: output -> the inputs that act on it at once; None where the FMU does not say.
        every: its communication step [base steps].
        instant: whether its outputs hold at once, and not from the end of its step on.
        categories: of its messages about trouble.
        saves: whether it can go back to a state.
        once: whether a process may have one instance of it only.
        needs_tool: whether it needs another program to run.
        files: archive name -> contents.
    """

    place: str
    title: str
    description: str
    fmi: int
    identifier: str
    token: str
    variables: tuple[NestedVariable, ...]
    values: Mapping[str, Number]
    feed_through: Mapping[str, frozenset[str] | None]
    every: int
    instant: bool
    categories: tuple[str, ...]
    saves: bool
    once: bool
    needs_tool: bool
    files: Mapping[str, bytes] = field(repr=False)

    @property
    def tables(self) -> Mapping[str, Table]:
        """None: what it plays back is its own."""
        return {}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Those that can be shown."""
        return self._names("parameter")

    @property
    def outputs(self) -> tuple[str, ...]:
        return self._names("output")

    @property
    def states(self) -> tuple[str, ...]:
        """Other variables that are read."""
        return self._names("local")

    @cached_property
    def digest(self) -> str:
        """Hash of its files."""
        return archive.digest(self.files)

    def _names(self, causality: str) -> tuple[str, ...]:
        names = (variable.shown.name for variable in self.variables if variable.shown.causality == causality)
        return tuple(name for name in names if not name.endswith(START))


START = " (start)"  # what the name of a variable gets that is set before it is computed, and is no parameter


def folders(parts: Mapping[str, NestedPart]) -> dict[str, str]:
    """Part -> its folder in the resources; equal files lie in one, unless a process may have one instance only."""
    found: dict[str, str] = {}
    first: dict[str, str] = {}
    for name, part in parts.items():
        found[name] = name if part.once else first.setdefault(part.digest, name)
    return found


def resources(parts: Mapping[str, NestedPart], platforms: Sequence[Platform]) -> dict[str, bytes]:
    """Archive name -> contents of what the system's FMU holds of these.

    Raises:
        ModelError: one has no library of a platform.
    """
    require_libraries(parts, platforms)
    files: dict[str, bytes] = {}
    for name, folder in folders(parts).items():
        part = parts[name]
        kept = {f"{BINARIES}{_folder(part, machine)}/" for machine in platforms}
        files |= {
            f"resources/{folder}/{file}": content
            for file, content in part.files.items()
            if not file.startswith(BINARIES) or any(file.startswith(one) for one in kept)
        }
    return files


def _folder(part: NestedPart, machine: Platform) -> str:
    return machine.folder2 if part.fmi == 2 else machine.name


def require_libraries(parts: Mapping[str, NestedPart], platforms: Sequence[Platform]) -> None:
    """See that all have a library for each platform.

    Raises:
        ModelError: one has none.
    """
    for name, part in parts.items():
        for machine in platforms:
            if f"{BINARIES}{_folder(part, machine)}/{part.identifier}{machine.suffix}" not in part.files:
                there = ", ".join(_platforms(part.files)) or "none"
                problem = f"'{name}' has no library for {machine.name} (it has: {there})"
                raise ModelError(part.place, problem, "export it for that platform, or leave the platform out")


def _platforms(files: Iterable[str]) -> list[str]:
    return sorted({file.split("/")[1] for file in files if file.startswith(BINARIES) and file.count("/") > 1})
