"""What is written as an SSP, in plain values, and for whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from orchestrator.fmi.file import FmuKind
from orchestrator.fmi.interface import Value
from orchestrator.ssp.names import Version
from orchestrator.system import System


class Tool(StrEnum):
    """What an SSP is written for: tools that keep to the standard, or one with habits of its own."""

    ANY = "any"
    OMSIMULATOR = "omsimulator"
    ECOS = "ecos"
    LIBCOSIM = "libcosim"
    FMPY = "fmpy"

    def writes(self, version: Version) -> bool:
        """Whether it is known what of this version it takes; of those with habits of their own it is of 1.0."""
        return self is Tool.ANY or version is Version.ONE

    @property
    def joins_system(self) -> bool:
        """Whether it takes connections to connectors of the system."""
        return self in (Tool.ANY, Tool.OMSIMULATOR)

    @property
    def transforms(self) -> bool:
        """Whether it applies linear transformations."""
        return self in (Tool.ANY, Tool.ECOS, Tool.LIBCOSIM)

    @property
    def knows_items(self) -> bool:
        """Whether it knows of enumerations."""
        return self not in (Tool.ECOS, Tool.LIBCOSIM)

    @property
    def sets_values(self) -> bool:
        """Whether it gives components the values that stand with them."""
        return self is not Tool.FMPY


@dataclass(frozen=True)
class Times:
    """When a run begins, ends, and how it steps [s]."""

    start: float
    stop: float
    step: float


@dataclass(frozen=True)
class Outline:
    """A system and what goes with it into an SSP.

    Attributes:
        files: component -> its FMU.
        values: component.variable -> value, in the unit of the variable.
        driven: input -> its constant value, None where it changes in time.
        recorded: what the outputs of the system show.
        annotations: of other tools, see `annotations.kept`.
        version: of SSP, which it is written as.
        others: name in the archive -> contents of what else goes along.
    """

    name: str
    description: str
    system: System
    files: Mapping[str, Path]
    kinds: Mapping[str, FmuKind]
    values: Mapping[str, Value]
    times: Times
    driven: Mapping[str, float | None] = field(default_factory=dict)
    recorded: tuple[str, ...] = ()
    annotations: Mapping[str, Sequence[bytes]] = field(default_factory=dict)
    others: Mapping[str, bytes] = field(default_factory=dict)
    version: Version = Version.ONE
