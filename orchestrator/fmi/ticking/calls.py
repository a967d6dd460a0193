"""What an FMU is asked and told about its clocks, with arguments that are prepared once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection, Sequence

from orchestrator.fmi.clocks.declared import Clock
from orchestrator.fmi.functions.base import FATAL, FmiFunctions
from orchestrator.fmi.said import LOG
from orchestrator.fmi.status import returned

OK, WARNING = 0, 1  # statuses
CHANGED = 2  # qualifier of an interval that is new
Require = Callable[[int, str], None]


class ClockCalls:
    """The functions about clocks of one instance.

    Args:
        require: raises where a status says that what was done, which it is told, went wrong.
    """

    def __init__(self, fmi: FmiFunctions, clocks: Sequence[Clock], require: Require) -> None:
        self._fmi, self._require = fmi, require
        self._outputs = [clock for clock in clocks if clock.causality == "output"]
        self._names = {clock.reference: clock.name for clock in clocks}
        self._listed = (ctypes.c_uint * len(self._outputs))(*(clock.reference for clock in self._outputs))
        self._active = (ctypes.c_bool * len(self._outputs))()

    def activate(self, references: Collection[int]) -> None:
        """Have these tick, in event mode."""
        count = len(references)
        listed, on = (ctypes.c_uint * count)(*sorted(references)), (ctypes.c_bool * count)(*([True] * count))
        status = self._fmi.call("SetClock", listed, ctypes.c_size_t(count), on)
        if status:
            self.ticked(status, references)

    def ticked(self, status: int, references: Collection[int]) -> None:
        """Take note of how it went to have these tick."""
        self._require(status, f"tick {', '.join(self._names[reference] for reference in sorted(references))}")

    def active(self) -> frozenset[str]:
        """Names of the output clocks that tick now, in event mode."""
        if not self._outputs:
            return frozenset()
        status = self._fmi.call("GetClock", self._listed, ctypes.c_size_t(len(self._outputs)), self._active)
        if status:
            self.shown(status)
        return frozenset(clock.name for clock, on in zip(self._outputs, self._active, strict=True) if on)

    def shifts(self, references: Sequence[int]) -> list[float]:
        """The shifts of these clocks [s], in initialisation mode; none of an FMU that refuses to tell them, which is
        said."""
        count = len(references)
        listed, found = (ctypes.c_uint * count)(*references), (ctypes.c_double * count)()
        status = self._fmi.call("GetShiftDecimal", listed, ctypes.c_size_t(count), found)
        if status in (OK, WARNING, FATAL):
            self._require(status, "tell the shifts of its clocks")
            return list(found)
        clocks = ", ".join(f"'{self._names[reference]}'" for reference in references)
        refused = f"fmi3GetShiftDecimal {returned(status)}, so the shift of its clocks {clocks} is taken as 0 s"
        LOG.warning("%s: %s", self._fmi.fmu.instanceName, refused)
        return []

    def shown(self, status: int) -> None:
        """Take note of how it went to get which output clocks tick."""
        self._require(status, "get its clocks")

    def asked(self, status: int) -> None:
        """Take note of how it went to ask for intervals."""
        self._require(status, "get the intervals of its clocks")

    def intervals(self, references: Sequence[int]) -> list[tuple[int, float]]:
        """Of these clocks those with a new interval, and that [s]."""
        count = len(references)
        listed, found = (ctypes.c_uint * count)(*references), (ctypes.c_double * count)()
        qualifiers = (ctypes.c_int * count)()
        status = self._fmi.call("GetIntervalDecimal", listed, ctypes.c_size_t(count), found, qualifiers)
        if status:
            self.asked(status)
        return [
            (reference, interval)
            for reference, interval, qualifier in zip(references, found, qualifiers, strict=True)
            if qualifier == CHANGED
        ]
