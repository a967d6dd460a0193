"""What an FMU of FMI 3.0 gives between communication points, as it says by itself (intermediate update)."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fmus.errors import WiringError
from fmus.words import listed, with_article
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.file import FmuFile, FmuKind
from orchestrator.fmi.functions.base import FAILED
from orchestrator.fmi.functions.updates import IntermediateUpdates
from orchestrator.fmi.interface import Interface
from orchestrator.fmi.said import LOG
from orchestrator.fmi.slave import Slave
from orchestrator.fmi.status import returned
from orchestrator.trace import Trace

if TYPE_CHECKING:
    from orchestrator.fmi.functions.co_simulation import CoSimulation

    _Base = Slave
else:
    _Base = object
_MOST = 1 << 26  # numbers that are kept


def check(place: str, interface: Interface, kind: FmuKind, names: Sequence[str]) -> None:
    """See that an FMU gives these variables between communication points.

    Raises:
        WiringError: it does not; the message names `place`.
    """
    if not names:
        return
    if kind is not FmuKind.CO_SIMULATION or not interface.updates:
        problem = "is of an FMU without intermediate update in co-simulation"
        raise WiringError(place, problem, "remove it, or export the FMU with providesIntermediateUpdate")
    for name in names:
        port = interface.ports.get(name)
        if port is None or port.name not in interface.intermediate:
            known = listed(sorted(interface.intermediate)) or "none"
            raise WiringError(place, f"'{name}' is nothing that the FMU gives within a step", f"it gives {known}")
        if not port.numeric:
            raise WiringError(place, f"'{name}' is {with_article(port.type)}", "choose variables that are numbers")


class _Intermediate(_Base):
    """Takes note of the values of some variables whenever the FMU has finished a step of its own.

    Attributes:
        updates: what the FMU is given to call.
        unfinished: how often it called with values of a step that was not finished, which are not kept.
    """

    def __init__(self, fmu: FmuFile, name: str, *, variables: Sequence[str]) -> None:
        self._variables = tuple(dict.fromkeys(variables))
        references = [fmu.interface.ports[one].reference for one in self._variables]
        self.updates = IntermediateUpdates(tuple(dict.fromkeys(references)), self._take)
        self._clear()
        super().__init__(fmu, name)

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._clear()
        super().begin(start, stop, tolerance)

    def step(self, time: float, duration: float) -> None:
        self._within = time, time + duration
        super().step(time, duration)
        if self.updates.problem:
            raise self._failure(f"update between t = {time:g} s and t = {time + duration:g} s", self.updates.problem)

    def save(self) -> Any:
        return super().save(), len(self._times), self.unfinished

    def restore(self, state: Any) -> None:
        memory, count, self.unfinished = state
        super().restore(memory)
        del self._times[count:], self._values[count * len(self._variables) :]

    def drop(self, state: Any) -> None:
        super().drop(state[0])

    def terminate(self) -> None:
        if self._under_way and not self._times:
            LOG.warning("%s: told of nothing within its steps, so that nothing is kept of them", self.name)
        elif self._under_way and self.unfinished:
            said = "told %s times of a step of its own that was not finished, of which nothing is kept"
            LOG.warning(f"%s: {said}", self.name, f"{self.unfinished:,}")
        super().terminate()

    @property
    def intermediate(self) -> Trace:
        """What it gave since the run began, component.variable; of several updates at one time the last."""
        times = np.array(self._times)
        values = np.array(self._values).reshape(len(times), len(self._variables))
        last = np.append(np.diff(times) > 0, True) if len(times) else np.array([], dtype=bool)
        signals = {f"{self.name}.{one}": values[last, place] for place, one in enumerate(self._variables)}
        units = {f"{self.name}.{one}": self.interface.ports[one].unit or "" for one in self._variables}
        return Trace(times[last], signals, {name: unit for name, unit in units.items() if unit}, self.name)

    def _functions(self, kind: Callable[..., CoSimulation], fmu: FmuFile) -> CoSimulation:
        return kind(fmu, self.name, self._log, self.updates)

    def _clear(self) -> None:
        self._times, self._values, self.unfinished = array("d"), array("d"), 0
        self._within, self.updates.problem = (0.0, 0.0), ""

    def _take(self, time: float, finished: bool) -> str:
        """Keep what there is at a time [s]; what is amiss."""
        if not finished:
            self.unfinished += 1
            return ""
        begin, end = self._within
        room = 1e-9 * (end - begin) + 1e-12 * abs(end)
        before = self._times[-1] if self._times else begin
        if not max(begin, before) - room <= time <= end + room:
            return f"it speaks of t = {time:.9g} s after {before:.9g} s, in a step up to {end:.9g} s"
        if len(self._values) >= _MOST:
            return f"more than {_MOST:,} numbers are to be kept: name fewer variables, or shorten the run"
        status, values = self._group(*self._variables).read()
        if status >= FAILED:
            return f"get {', '.join(self._variables)}: {returned(status)}"
        self._times.append(max(time, before))
        self._values.extend(values)
        return ""


class IntermediateSlave(_Intermediate, Slave):
    """A co-simulation FMU whose values between communication points are kept."""


class IntermediateClockedSlave(_Intermediate, ClockedSlave):
    """The same with clocks."""


def maker(interface: Interface) -> type[IntermediateSlave | IntermediateClockedSlave]:
    """The class of instances of an FMU."""
    return IntermediateClockedSlave if interface.ticks else IntermediateSlave
