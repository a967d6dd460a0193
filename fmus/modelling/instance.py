"""One running instance of a model in plain Python: the specification of how a model is initialised and stepped.

Inputs are held over a step; those that act late (`late.py`) show in outputs as they acted over it, and once an input is
set, as they will over another step as long. Sampled states change at start + k sample_time, at the beginning of the
step that reaches that instant, with the inputs of that instant; continuous states are integrated by the classical
Runge-Kutta method (order 4) with equal inner steps no longer than the model's `solver_step`. The file travels
inside every Python FMU.
"""

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, TypedDict

from .late import LONGEST, History, Row, acting
from .model import Delay, Model, Named, Table, assign, namespace, start_values

REFUSED = "logParameters"  # category of messages about parameters that do not fit together
MOST_NAMED = 8  # of these parameters
EARLY = 1e-6  # of a sample period: how far rounding may put a step's end before or after a sampling instant


class StepError(RuntimeError):
    """The model cannot go on: a requirement does not hold or a state is not finite."""


class Snapshot(TypedDict):
    """Everything of an instance that changes while it runs."""

    x: Named
    u: Named
    p: Named
    time: float
    start: float
    samples: int
    stepped: bool
    late: list[Any]
    duration: float
    touched: bool


class Instance:
    """State, inputs and parameters of one model, and the operations of a co-simulation slave on them."""

    def __init__(
        self, model: Model, defaults: dict[str, float] | None = None, tables: dict[str, Table] | None = None
    ) -> None:
        self.model = model
        values = start_values(model)
        for name, value in (defaults or {}).items():
            if name not in values:
                raise KeyError(f"{model.name} has no input or parameter '{name}'")
            values[name] = value
        self.u = namespace({v.name: values[v.name] for v in model.of("input")})
        self.p = namespace({v.name: values[v.name] for v in model.of("parameter")})
        for name in model.tables:
            setattr(self.p, name, (tables or {}).get(name) or Table(name))
        self.x = namespace({})
        self._late = [(delay, History()) for delay in model.delays]
        self._acting = SimpleNamespace(**self.u.__dict__) if model.delays else self.u
        self._continuous = [state.name for state in model.continuous]
        self._results: dict[str, float] | None = None
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Put the states at their start values; may be called again when a parameter has changed."""
        self.time = self.start = time
        self.samples = 0
        self.stepped = False
        self.duration, self._touched = 0.0, True
        for _, history in self._late:
            history.rows.clear()
        for state in self.model.states:
            start = getattr(self.p, state.start) if isinstance(state.start, str) else state.start
            setattr(self.x, state.name, float(start))
        self._results = None

    def set(self, name: str, value: float) -> None:
        """Give an input or parameter a value; start values follow a parameter until the first step.

        Raises:
            KeyError: the model has no input or parameter of that name.
        """
        if name in self.u.__dict__:
            setattr(self.u, name, value)
            self._results, self._touched = None, True
            return
        if name not in self.p.__dict__ or name in self.model.tables or name in self.model.arrays:
            raise KeyError(f"{self.model.name} has no input or parameter '{name}'")
        assign(self.p, name, value)
        if self.stepped:
            self._results = None
        else:
            self.begin(self.start)

    def get(self, name: str) -> float:
        """Value of any variable: input, parameter, or output at the present time.

        Raises:
            KeyError: the model has no variable of that name.
        """
        for place in (self.u, self.p, self.x):
            if name in place.__dict__ and name not in self.model.arrays:
                value: float = place.__dict__[name]
                return value
        if self._results is None:
            outputs = self.model.outputs
            if self._late and self._touched:
                self._foresee()
            self._results = dict(outputs(self.time, self.x, self._acting, self.p)) if outputs else {}
        return self._results[name]

    def step(self, time: float, duration: float) -> None:
        """Advance from `time` by `duration` [s].

        Raises:
            StepError: a requirement of the model does not hold, or a state became infinite or NaN.
        """
        if not self.stepped:
            self._prepare(time)
        self._results = None
        if self._late:
            self._arrive(time, duration)
        end = time + duration
        now = time
        if self.model.update and self.model.sample_time:
            period = getattr(self.p, self.model.sample_time)
            while (due := self.start + self.samples * period) < end - EARLY * period:
                if due > now:
                    self._integrate(now, due - now)
                    now = due
                self.x.__dict__.update(self.model.update(due, self.x, self._acting, self.p))
                self.samples += 1
        self._integrate(now, end - now)
        self.time = end
        self._check_finite()

    def conflict(self, about: Mapping[int, Sequence[str]]) -> str | None:
        """Which parameters do not fit together, and why.

        Args:
            about: number of a requirement -> the parameters that it depends on, and on nothing else.
        """
        for number, names in about.items():
            requirement = self.model.requirements[number]
            if not requirement.holds(self.time, self.x, self.u, self.p):
                given = [f"{name} = {self.get(name):g}" for name in names[:MOST_NAMED]]
                return f"{', '.join([*given, '...'][: len(names)])}: {requirement.reason}"
        return None

    def snapshot(self) -> Snapshot:
        """Everything that changes while running, for `restore`."""
        return {
            "x": dict(self.x.__dict__),
            "u": dict(self.u.__dict__),
            "time": self.time,
            "start": self.start,
            "samples": self.samples,
            "stepped": self.stepped,
            "late": [history.snapshot() for _, history in self._late],
            "duration": self.duration,
            "touched": self._touched,
            "p": {v.name: getattr(self.p, v.name) for v in self.model.of("parameter")},
        }

    def restore(self, state: Snapshot) -> None:
        """Go back to a snapshot."""
        for place, values in ((self.x, state["x"]), (self.u, state["u"]), (self.p, state["p"])):
            for name, value in values.items():
                assign(place, name, value)
        self.time, self.start = state["time"], state["start"]
        self.samples, self.stepped = state["samples"], state["stepped"]
        self._results = None
        self.duration, self._touched = state["duration"], state["touched"]
        for (delay, history), kept in zip(self._late, state["late"], strict=True):
            history.restore(kept)
            setattr(self._acting, delay.input, history.acts)
        self._choose_step()

    def _arrive(self, time: float, duration: float) -> None:
        """Have act over this step what reaches the model in it."""
        self._acting.__dict__.update(self.u.__dict__)
        for delay, history in self._late:
            if not history.push(time, getattr(self.u, delay.input), getattr(self.p, delay.seconds)):
                raise StepError(f"'{delay.input}' is later than {LONGEST} steps")
            history.acts = self._over(delay, history.rows, time, duration)
            setattr(self._acting, delay.input, history.acts)
        self.duration, self._touched = duration, False

    def _foresee(self) -> None:
        """Have act what would over another step as long."""
        self._acting.__dict__.update(self.u.__dict__)
        for delay, history in self._late:
            rows = history.with_last(self.time, getattr(self.u, delay.input))
            setattr(self._acting, delay.input, self._over(delay, rows, self.time, self.duration))

    def _over(self, delay: Delay, rows: list[Row], time: float, duration: float) -> float:
        """What of an input acts over a step."""
        begins, p = time - getattr(self.p, delay.seconds), self.p
        return acting(rows, begins, begins + duration, getattr(p, delay.before), getattr(p, delay.shape) > 1.5)

    def _prepare(self, time: float) -> None:
        for requirement in self.model.requirements:
            if not requirement.holds(time, self.x, self.u, self.p):
                raise StepError(requirement.reason)
        self._choose_step()
        self.stepped = True

    def _choose_step(self) -> None:
        self._longest = self.model.solver_step(self.p) if self.model.solver_step else math.inf

    def _integrate(self, time: float, duration: float) -> None:
        if not self._continuous or duration <= 0:
            return
        count = max(1, math.ceil(duration / self._longest - 1e-9))
        inner = duration / count
        for i in range(count):
            self._runge_kutta(time + i * inner, inner)

    def _runge_kutta(self, t: float, h: float) -> None:
        f, x, u, p = self.model.derivatives, self.x, self._acting, self.p
        assert f is not None
        values = x.__dict__
        base = [(name, values[name]) for name in self._continuous]
        k1 = f(t, x, u, p)
        for name, start in base:
            values[name] = start + 0.5 * h * k1[name]
        k2 = f(t + 0.5 * h, x, u, p)
        for name, start in base:
            values[name] = start + 0.5 * h * k2[name]
        k3 = f(t + 0.5 * h, x, u, p)
        for name, start in base:
            values[name] = start + h * k3[name]
        k4 = f(t + h, x, u, p)
        for name, start in base:
            values[name] = start + h / 6.0 * (k1[name] + 2.0 * (k2[name] + k3[name]) + k4[name])

    def _check_finite(self) -> None:
        for name, value in self.x.__dict__.items():
            if not math.isfinite(value):
                raise StepError(f"state '{name}' is {value} at t = {self.time:g} s")
