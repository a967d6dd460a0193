"""The contract of a method of identification: from a study to a typed result, and what of that is written.

`study.METHODS` is the table of methods; each room has its own in `method.py`. A package adds one by an entry point of
the group `servotwin.methods`, named as its studies' `method` and leading to a `Method`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from identification.recordings.schema import StudyBlock
from identification.results import Summary
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.report import Report


@dataclass(frozen=True)
class CalibratedFmu:
    """An FMU as it was before a calibration, and the values that go into it.

    Attributes:
        source: the FMU file.
        values: variable -> value [unit of the variable].
        step: with which the values were found, which importers then take by default [s].
    """

    source: Path
    values: Mapping[str, Value]
    step: float | None = None


@dataclass(frozen=True)
class Calibrated:
    """What of a result is for other tools.

    Attributes:
        fmus: file name without suffix -> FMU.
        parameters: component.variable -> value for `parameters.ssv`, all that differ from what FMUs start with; without
            any there is no such file.
        units: of the parameters that have one.
        groups: name of a group of recordings -> values that it has in the place of those of `parameters`.
    """

    fmus: Mapping[str, CalibratedFmu]
    parameters: Mapping[str, Value] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)


StudyType = TypeVar("StudyType", bound=StudyBlock)
ResultType = TypeVar("ResultType")


def of_study(
    calibrate: Callable[[Any, Path | None, Progress, Isolation | None], ResultType],
) -> Callable[[Any, Path, Path | None, Progress, Isolation | None], ResultType]:
    """The `run` of a method whose schema makes a study of a file, and that needs nothing but that and recordings."""
    return lambda block, base, data, progress, isolation: calibrate(block.study(base), data, progress, isolation)


def without_data(
    tune: Callable[[Any, Progress, Isolation | None], ResultType],
) -> Callable[[Any, Path, Path | None, Progress, Isolation | None], ResultType]:
    """The `run` of a method whose schema makes a study of a file, and that needs no recordings."""
    return lambda block, base, data, progress, isolation: tune(block.study(base), progress, isolation)


@dataclass(frozen=True)
class Method(Generic[StudyType, ResultType]):
    """One method.

    Attributes:
        schema: of its study files; `method` there is its name in the table.
        run: (study, folder of its file, recordings over the study's own, progress, isolation of FMUs) -> result. Raises
            InputError where the study and the recordings do not fit together, FmuError where FMUs fail.
        summary: the result as `summary.json` holds it.
        report: the result as a page.
        calibrated: what of it is written for other tools; FMUs that are built for that go into the given folder.
        command: of the command line, that its studies are for.
        files: writes what else a result leaves into a folder that becomes another (the last argument); None where it
            leaves nothing.
    """

    schema: type[StudyType]
    run: Callable[[StudyType, Path, Path | None, Progress, Isolation | None], ResultType]
    summary: Callable[[ResultType], Summary]
    report: Callable[[ResultType], Report]
    calibrated: Callable[[ResultType, Path], Calibrated]
    command: Literal["calibrate", "tune", "design"] = "calibrate"
    files: Callable[[ResultType, Path, Path], None] | None = None
