"""The errors of the project: each names the place, what is wrong there, and the fix.

ServotwinError            anything we refuse; the command line prints its one line
├── InputError            bad input from outside (exit code 2)
│   ├── ModelError        a model file: unknown variable, missing derivative, ...
│   ├── TraceError        a recording: unreadable, wrong column, NaN, bad stamps
│   │   └── AbsentError       signals have no value in a CAN log
│   ├── WiringError       wiring: unknown component or variable, units, cycles, steps
│   ├── ScenarioError     a scenario or study file that does not fit its schema
│   ├── DatabaseError     a CAN database (DBC, ...) that cannot be read, or lacks what was asked of it
│   ├── FmuFileError      an FMU that cannot be read, or has no binary for this platform
│   └── IdentificationError   data or settings that cannot answer the question that was asked
├── FmuError              an FMU failed while it was used (exit code 3)
│   ├── PartialError      `result` is what there was until then
│   │   ├── RunFailed         of a run
│   │   ├── ScenarioFailed    of a scenario: the cases before it, and all up to there
│   │   └── EstimationFailed  of an estimation
│   ├── ParametersRefused parameters of one of ours do not fit together, and no step was taken (exit code 2)
│   ├── StepDiscarded     a step is too long for it: whoever can go back takes a shorter one
│   ├── TangentsMissing   it cannot be differentiated exactly: whoever asked takes differences
│   └── FmuEnded          it asked to stop: the run ends well where whoever steps it knows what to do with one that ends
├── RecordError           what is recorded from something real cannot be kept (exit code 3)
├── BusError              a CAN bus or its adapter failed while it was used (exit code 3)
└── InternalError         what should not be possible: the fault is in this project (exit code 4)
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self


class ServotwinError(Exception):
    """`place` is a file or component.variable; `fix` says what to do about it. The whole is one line, whatever names
    from outside hold."""

    exit_code = 2

    def __init__(self, place: object, problem: str, fix: str = "") -> None:
        self.place, self.problem, self.fix = str(place), problem, fix
        message = f"{place}: {problem}" + (f"; {fix}" if fix else "")
        super().__init__(" ".join(line.strip() for line in message.splitlines() if line.strip()))

    def within(self, place: object) -> Self:
        """The same error, with a place before its own."""
        wider = type(self).__new__(type(self))
        wider.__dict__.update(self.__dict__)
        ServotwinError.__init__(wider, f"{place}: {self.place}", self.problem, self.fix)
        return wider

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.place, self.problem, self.fix)


class InputError(ServotwinError, ValueError):
    """Something from outside is wrong; nothing was run or written."""


@contextmanager
def within(place: str) -> Iterator[None]:
    """What is refused there names the place, if it does not yet."""
    try:
        yield
    except InputError as error:
        if error.place.startswith(place):
            raise
        raise error.within(place) from error


class ModelError(InputError):
    """A model file declares or computes something that does not fit together."""


class TraceError(InputError):
    """A recording cannot be read or does not hold what was asked of it."""


class WiringError(InputError):
    """Components, parameters and connections do not make a runnable system."""


class ScenarioError(InputError):
    """A scenario or study file has an unknown key, a wrong type or an impossible value."""


class DatabaseError(InputError):
    """A CAN database cannot be read, or does not hold what was asked of it."""


class FmuFileError(InputError):
    """An FMU file cannot be used here: no zip, bad XML, no binary for this platform."""


class FmuError(ServotwinError, RuntimeError):
    """An FMU returned an error status, or did not take a value."""

    exit_code = 3


class PartialError(FmuError):
    """An FMU, or a bus that it is on, failed; `result` is what there was until then.

    From one process to another it travels as the error that it is of.
    """

    def __init__(self, error: FmuError | BusError, result: Any) -> None:
        super().__init__(error.place, error.problem, error.fix)
        self.result, self.exit_code = result, error.exit_code

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        of = ParametersRefused if self.exit_code == ParametersRefused.exit_code else FmuError
        return of, (self.place, self.problem, self.fix)


class ParametersRefused(FmuError):  # noqa: N818 - as what is refused
    """Parameters of an FMU do not fit together: what a search skips, and bad input where a person gave them."""

    exit_code = 2


class TangentsMissing(FmuError):  # noqa: N818 - nothing has failed
    """A run cannot carry the derivatives that it was asked for."""


class StepDiscarded(FmuError):  # noqa: N818 - as FMI calls it
    """An FMU did not get through a step."""


class FmuEnded(FmuError):  # noqa: N818 - nothing is wrong
    """An FMU asked to stop."""


class BusError(ServotwinError, RuntimeError):
    """A CAN bus could not be opened, or failed while it was used."""

    exit_code = 3


class RecordError(ServotwinError, RuntimeError):
    """A disk does not take what is recorded while it goes on."""

    exit_code = 3


class IdentificationError(InputError):
    """The data or the settings do not allow the estimate that was asked for."""


class InternalError(ServotwinError):
    """An exception that nobody foresaw; whoever meets it can only report it."""

    exit_code = 4

    @classmethod
    def of(cls, error: BaseException) -> InternalError:
        """What is told of an exception."""
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return cls("a fault of servotwin", what, "run with -vv and report what that says")


def ours(error: Exception) -> ServotwinError:
    """The exception as an error of ours: what cannot be a matter of the input is a fault."""
    if isinstance(error, ServotwinError):
        return error
    if isinstance(error, OSError) and error.errno != errno.EBADF:
        return InputError(error.filename or "file", error.strerror or str(error), "check the path")
    if isinstance(error, MemoryError):
        return InputError("memory", f"is too small ({error or 'nothing more to be had'})", "give it less at once")
    return InternalError.of(error)
