"""An FMU for model exchange as a component: a solver integrates its states within each step, from event to event.

A step ends with left limits: what happens at its very end (within a billionth of it), a time event, a jump of an
input, belongs to the beginning of the next step, where the FMU is given its new inputs.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from fmus.errors import FmuEnded
from orchestrator.fmi.clocks.ticks import NOTHING, Arrival, Tick
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.base import DISCARD, FAILED
from orchestrator.fmi.functions.co_simulation import EarlyStop
from orchestrator.fmi.functions.model_exchange import Exchange2, Exchange3, ModelExchange
from orchestrator.fmi.instance import FmuInstance
from orchestrator.fmi.interface import Value
from orchestrator.fmi.status import stepping
from orchestrator.fmi.ticking.inputs import InputPart, parts
from orchestrator.fmi.ticking.ticker import Ticker
from orchestrator.solvers.base import Solver, SolverSettings, Stateless
from orchestrator.solvers.choice import solver_type
from orchestrator.trace import FloatArray

_TOGETHER = 1e-9  # times that differ by less than this share of a step are one
_ROUNDING = 16 * sys.float_info.epsilon
_MOST_TURNS = 100  # of one event iteration
_MOST_EVENTS = 100  # at one time


@dataclass
class _ExchangeMoment:
    """Where an instance is between two calls.

    Attributes:
        time: of the FMU [s].
        next_event: time of the next event that is known in advance [s].
        due: whether something has happened that needs event mode.
        in_event_mode: otherwise it is in continuous-time mode.
        inputs: the values it was given last.
        positive: for each event indicator, a byte, whether it was above zero after the latest event.
    """

    time: float
    next_event: float = math.inf
    due: bool = False
    in_event_mode: bool = False
    inputs: Sequence[float] | None = None
    positive: bytes = b""


class ExchangeSlave(FmuInstance[ModelExchange]):
    """An instance of a model exchange FMU; see `Component` for the meaning of the methods.

    An event indicator that crosses zero twice within one internal step of the solver is not seen, as in most solvers.

    Raises (on instantiation):
        WiringError: this platform has no such solver.
    """

    versions = (Exchange2, Exchange3)

    def __init__(self, fmu: FmuFile, name: str, settings: SolverSettings | None = None) -> None:
        self._ticker = Ticker(fmu.interface.clocks.values())
        self._parts: list[InputPart] = []
        self._settings = settings or SolverSettings()
        self._type = solver_type(self._settings.method, name)
        self._solver: Solver = Stateless(self._rates, 0, self._settings)
        self._now = _ExchangeMoment(0.0)
        self._running = False
        self._over = False  # before its first step
        self._stale = True  # the solver has to start anew
        self._snapshots = 0
        self._undefined = ""  # what was not finite in this internal step
        self._doing = ""
        super().__init__(fmu, name)

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._now, self._over = _ExchangeMoment(start), False
        super().begin(start, stop, self._settings.relative_tolerance)
        self._ticker.begin(start, self._fmi, self._check)

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        super().bind(inputs, outputs)
        self._parts = parts(self.interface, inputs, self._group)
        self._now.inputs = None

    def write(self, values: Sequence[float]) -> None:
        """Set the bound inputs. New values are an event: they may have jumped."""
        values = list(values)
        if self._running and values == self._now.inputs:
            return
        before = self._now.inputs
        if before is None or not self._running or not self.interface.clocked:
            if self._running:
                self._enter_event_mode()
            super().write(values)
        elif any(part.changed(before, values) for part in self._parts if not part.clocks):
            self._enter_event_mode()
            self._put(values, frozenset(), {})
        self._now.inputs = values

    def tune(self, name: str, value: Value) -> Value:
        """Give it a value; that is an event, once it is initialised."""
        if self._running:
            self._enter_event_mode()
        return super().tune(name, value)

    def run(self) -> None:
        self._doing = "initialise"
        if problem := self._ticker.ask_shifts():
            self._fail(problem, "correct its description or the FMU")
        super().run()
        self._fmi.measure()
        size = self._fmi.states.values.size
        if size and isinstance(self._solver, Stateless):
            try:
                self._solver = self._type(self._rates, size, self._settings)
            except MemoryError as error:
                self._fail(f"there is no memory for {error}", "give its `solver` an explicit `method`")
        self._now.in_event_mode = self._running = True
        try:
            self._settle(beginning=True)
        except FmuEnded:  # so does its first step, when all others are there, too
            self._over = True

    def step(self, time: float, duration: float) -> None:
        if self._over:
            raise FmuEnded(self.name, str(EarlyStop(time, True)))
        self._ticker.passed = []
        end = time + duration
        together = max(_TOGETHER * duration, _ROUNDING * abs(end))
        events: deque[float] = deque(maxlen=_MOST_EVENTS)
        steps = 0
        self._doing = stepping(time, duration)
        while self._now.time < end:
            now = self._now
            if now.in_event_mode or now.due or self.next_event <= now.time + together:
                events.append(now.time)
                if len(events) == _MOST_EVENTS and now.time - events[0] <= together:
                    self._fail(f"{_MOST_EVENTS} events at t = {now.time:.9g} s", "ask its supplier for hysteresis")
                self._pass_event(together)
            elif steps < self._settings.most_steps:
                self._integrate(self.next_event if self.next_event < end - together else end, end - together)
                steps += 1
            else:
                self._fail(
                    f"{steps} internal steps reached t = {now.time:.9g} s only",
                    "give its `solver` more `most_steps`, or another `method`",
                )

    @property
    def next_event(self) -> float:
        """Time of the next event that is known in advance [s], infinity without one."""
        return min(self._now.next_event, self._ticker.next)

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        self._ticker.expect(arrivals)

    def passed(self) -> Sequence[Tick]:
        return self._ticker.passed

    def states(self) -> FloatArray:
        """(n,) where its states are."""
        self._require(self._fmi.states.get(), "get its states")
        return self._fmi.states.values.copy()

    def answer(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (n,) and bound outputs at other states (n,) and bound inputs, where nothing is stepped."""
        super().write(inputs.tolist())
        rates = self._rates(self._now.time, states).copy()
        return rates, np.array(self.read(), dtype=float)

    def directional(self) -> FloatArray | None:
        """(n + p, n + m) directional derivatives of rates and bound outputs by states and bound inputs, where it is;
        None where it offers none."""
        rates = [unknown.variable for unknown in self._fmi.description.derivatives]
        ports = [[self._port(name) for name in names] for names in self._bound]
        arrays = any(port.array for side in ports for port in side)
        if not self._fmi.directional or arrays or len(rates) != self._fmi.states.values.size:
            return None
        inputs, outputs = ([port.reference for port in side] for side in ports)
        unknown = [*(rate.valueReference for rate in rates), *outputs]
        columns = []
        for known in (*(rate.derivative.valueReference for rate in rates), *inputs):
            status, column = self._fmi.along(known, unknown)
            self._require(status, "get directional derivatives")
            columns.append(column)
        return np.stack(columns, axis=1) if columns else None

    def save(self) -> Any:
        memory = super().save()
        self._snapshots += 1
        self._stale = True  # so that the step from here is the same each time
        return memory, dataclasses.replace(self._now), self._ticker.saved()

    def restore(self, state: Any) -> None:
        memory, moment, ticker = state
        super().restore(memory)
        self._ticker.restore(ticker)
        self._now = dataclasses.replace(moment)
        self._stale = True

    def drop(self, state: Any) -> None:
        self._snapshots -= 1
        super().drop(state[0])

    def reset(self) -> bool:
        self._running, self._snapshots = False, 0
        return super().reset()

    def close(self) -> None:
        super().close()
        self._solver.close()

    def _enter_event_mode(self) -> None:
        if not self._now.in_event_mode:
            self._require(self._fmi.call("EnterEventMode"), "enter event mode")
            self._now.in_event_mode = True

    def _pass_event(self, together: float) -> None:
        """Let the FMU change what changes in jumps."""
        now = self._now
        if not now.in_event_mode and now.time < self.next_event <= now.time + together:
            now.time = self.next_event
            self._require(self._fmi.set_time(now.time), "set its time")
        self._enter_event_mode()
        self._settle(*self._ticker.due(now.time + together))

    def _settle(
        self, ticking: frozenset[int] = frozenset(), brought: Mapping[int, float] = NOTHING, beginning: bool = False
    ) -> None:
        """Iterate an event to its end, with these clocks ticking, and go on in continuous time."""
        now, clocked = self._now, bool(self.interface.clocks)
        for _ in range(_MOST_TURNS):
            if ticking:
                self._put(now.inputs or (), self._ticker.activate(ticking), brought)
            if clocked:
                self._ticker.tell(now.time, self.read)
            status, news = self._fmi.update()
            self._require(status, "update its discrete states")
            if clocked and (problem := self._ticker.learn(now.time, ticking, beginning)):
                self._fail(problem, "correct its description or the FMU")
            if news.ending:
                raise FmuEnded(self.name, str(EarlyStop(now.time, True)))
            ticking = frozenset() if beginning else self._ticker.at_once(now.time)
            if not (news.again or ticking):
                break
        else:
            self._fail(
                f"the event at t = {now.time:.9g} s does not end in {_MOST_TURNS} iterations",
                "ask its supplier for a model that settles",
            )
        self._require(self._fmi.call("EnterContinuousTimeMode"), "enter continuous-time mode")
        now.in_event_mode = now.due = False
        now.next_event, now.positive = news.next_event, self._positive()
        self._stale = True

    def _put(self, values: Sequence[float], ticking: frozenset[str], brought: Mapping[int, float]) -> None:
        """Set, in event mode, the bound inputs that belong to no clock or to one of these."""
        given = [brought.get(place, value) for place, value in enumerate(values)]
        for part in self._parts:
            if not part.clocks or part.clocks & ticking:
                self._require(part.write(given), "set inputs")

    def _integrate(self, limit: float, last: float) -> None:
        """Take one internal step; an event from time `last` on is left to the next communication step."""
        now, before = self._now, self._now.time
        try:
            if self._stale:
                self._restart()
            reached = self._solver.step(limit)
            self._place(reached)
            if now.positive and self._positive() != now.positive:
                crossing = self._crossing(before, reached)
                self._place(crossing if crossing < last else reached)
                now.due = True
        except ArithmeticError as error:
            self._fail(
                f"{self._settings.method} at t = {now.time:.9g} s: {error}{self._undefined}",
                "loosen the `relative_tolerance` of its `solver`, or take another `method`",
            )
        self._undefined = ""
        self._complete()

    def _complete(self) -> None:
        """Tell the FMU that an internal step is over."""
        status, event, ending = self._fmi.complete_step(self._snapshots == 0)
        self._require(status, "complete an internal step")
        if ending:
            raise FmuEnded(self.name, str(EarlyStop(self._now.time, True)))
        self._now.due = self._now.due or event

    def _restart(self) -> None:
        """Have the solver start from the FMU's present states."""
        fmi, now = self._fmi, self._now
        self._require(fmi.states.get(), "get its states")
        self._require(fmi.nominals.get(), "get its nominal values")
        states, nominals = fmi.states.values.copy(), np.abs(fmi.nominals.values)
        if not np.isfinite(self._rates(now.time, states)).all():
            self._fail(f"cannot go on{self._undefined}", "see to its inputs, parameters and start values")
        self._solver.restart(now.time, states, np.where(np.isfinite(nominals) & (nominals > 0), nominals, 1.0))
        self._stale = False

    def _rates(self, time: float, states: FloatArray) -> FloatArray:
        """(n,) the derivatives; not finite where the FMU has none."""
        fmi = self._fmi
        status = fmi.put(time, states)
        if status < FAILED:
            status = max(status, fmi.rates.get())
        rates = fmi.rates.values
        if status == DISCARD:
            rates[:] = math.nan
            self._undefined = f", for there are no derivatives at t = {time:.9g} s"
            return rates
        self._require(status, "get derivatives")
        if not np.isfinite(rates).all():
            bad = int(np.argmin(np.isfinite(rates)))
            self._undefined = f", for {fmi.rate_name(bad)} is {rates[bad]} at t = {time:.9g} s"
        return rates

    def _place(self, time: float) -> None:
        """Put the FMU at a time within the solver's latest step."""
        states = self._solver.at(time)
        if not np.isfinite(states).all():
            raise ArithmeticError("its states are not finite")
        self._now.time = time
        self._require(self._fmi.put(time, states), "set its states")

    def _positive(self) -> bytes:
        """For each event indicator whether it is above zero."""
        indicators = self._fmi.indicators
        self._require(indicators.get(), "get event indicators")
        return (indicators.values > 0).tobytes()

    def _crossing(self, before: float, after: float) -> float:
        """The first time in the solver's latest step at which an event indicator is on another side of zero than after
        the latest event, by bisection down to rounding errors [s]."""
        tolerance = _ROUNDING * max(abs(before), abs(after))
        while after - before > tolerance:
            middle = 0.5 * (before + after)
            self._place(middle)
            if self._positive() == self._now.positive:
                before = middle
            else:
                after = middle
        return after

    def _require(self, status: int, action: str) -> None:
        if status:
            self._check(status, f"{action} at t = {self._now.time:g} s")

    def _fail(self, problem: str, fix: str = "") -> NoReturn:
        raise self._failure(self._doing, problem, fix)
