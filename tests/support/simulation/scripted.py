"""Components without any FMU for tests of the engine: exact linear plants, samplers, gains, trouble-makers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.linalg

from fmus.errors import FmuError
from orchestrator.assembly.wiring import wire
from orchestrator.engine import REFUSED, CycleSettings, Engine, Order, Simulation, Timing
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.system import FeedThrough, Part, System
from orchestrator.trace import FloatArray

Matrix = FloatArray


def interface(
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    direct: Mapping[str, Iterable[str] | None] | None = None,
    parameters: Mapping[str, float] | None = None,
    **more: Any,
) -> Interface:
    """An interface of real variables: inputs start at 0; `direct` as an FMU would declare it, none by default."""
    ports = [Port(name, 0, "Real", "input", start="0") for name in inputs]
    ports += [Port(name, 0, "Real", "output") for name in outputs]
    ports += [Port(name, 0, "Real", "parameter", start=repr(value)) for name, value in (parameters or {}).items()]
    declared = {name: (direct or {}).get(name, ()) for name in outputs}
    return Interface(
        model_name="scripted",
        fmi_version="2.0",
        ports={port.name: port for port in ports},
        feed_through={name: None if each is None else frozenset(each) for name, each in declared.items()},
        has_state=more.pop("has_state", True),
        **more,
    )


class Scripted:
    """Base of the scripted components: keeps values by name, and a log of what the engine asked for.

    Attributes:
        log: names of the calls, in order.
        steps: (time, duration, inputs) of every step.
        fail_at: number of the step (from 0) that fails, None for none.
        warn_at: numbers of the steps that return a warning.
    """

    def __init__(self, name: str, interface: Interface) -> None:
        self.name = name
        self.interface = interface
        self.warnings = 0
        self.fail_at: int | None = None
        self.warn_at: frozenset[int] = frozenset()
        self.log: list[str] = []
        self.steps: list[tuple[float, float, tuple[float, ...]]] = []
        self.closed = 0
        self._starts = {port.name: float(port.start or 0) for port in interface.ports.values()}
        self.values = dict(self._starts)
        self._inputs: tuple[str, ...] = ()
        self._outputs: tuple[str, ...] = ()
        self._count = 0
        self.restart()

    @property
    def u(self) -> FloatArray:
        """Present inputs, in the interface's order."""
        return np.array([self.values[port.name] for port in self.interface.of("input")])

    def restart(self) -> None:
        """Put the own state where a run begins."""

    def advance(self, time: float, duration: float) -> None:
        """Take a step."""

    def outputs(self) -> Sequence[float]:
        """Values of all outputs, in the interface's order."""
        return ()

    def state(self) -> Any:
        """A copy of the own state."""
        return None

    def put(self, state: Any) -> None:
        """Go back to a copy."""

    def set(self, values: Mapping[str, Value]) -> None:
        self.values.update({name: float(value) for name, value in values.items()})

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self.log.append("begin")
        self.restart()

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._inputs, self._outputs = tuple(inputs), tuple(outputs)

    def write(self, values: Sequence[float]) -> None:
        self.values.update(zip(self._inputs, values, strict=True))

    def get(self, name: str) -> Value:
        return self.values[name]

    def tune(self, name: str, value: Value) -> Value:
        self.values[name] = float(value)
        return self.values[name]

    def read(self) -> list[float]:
        now = dict(zip([port.name for port in self.interface.of("output")], self.outputs(), strict=True))
        return [float(now[name]) for name in self._outputs]

    def run(self) -> None:
        self.log.append("run")

    def step(self, time: float, duration: float) -> None:
        self.log.append("step")
        number, self._count = self._count, self._count + 1
        if number == self.fail_at:
            raise FmuError(self.name, f"step from t = {time:g} s by {duration:g} s: returned error")
        self.warnings += number in self.warn_at
        self.steps.append((time, duration, tuple(self.u)))
        self.advance(time, duration)

    def save(self) -> Any:
        self.log.append("save")
        return dict(self.values), self.state()

    def restore(self, state: Any) -> None:
        values, own = state
        self.values = dict(values)
        self.put(own)

    def drop(self, state: Any) -> None:
        self.log.append("drop")

    def terminate(self) -> None:
        self.log.append("terminate")

    def reset(self) -> bool:
        self.log.append("reset")
        self.values = dict(self._starts)
        self.warnings = self._count = 0
        self.restart()
        return False

    def close(self) -> None:
        self.closed += 1


class Plant(Scripted):
    """x' = A x + B u with u held over a step, y = C x + D u; the step is exact (matrix exponential)."""

    def __init__(
        self, name: str, A: Matrix, B: Matrix, C: Matrix, D: Matrix | None = None, x0: Sequence[float] = ()
    ) -> None:
        self.A, self.B, self.C = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(C)
        self.D = np.zeros((len(self.C), self.B.shape[1])) if D is None else np.atleast_2d(D)
        self.x0 = np.array(x0 if len(x0) else np.zeros(len(self.A)), dtype=float)
        self._discrete: dict[float, tuple[Matrix, Matrix]] = {}
        inputs = [f"u{i}" for i in range(self.B.shape[1])]
        direct = {f"y{i}": [u for u, d in zip(inputs, row, strict=True) if d] for i, row in enumerate(self.D)}
        super().__init__(name, interface(inputs, direct, direct))

    def restart(self) -> None:
        self.x = self.x0.copy()

    def advance(self, time: float, duration: float) -> None:
        if duration not in self._discrete:
            self._discrete[duration] = zero_order_hold(self.A, self.B, duration)
        Ad, Bd = self._discrete[duration]
        self.x = Ad @ self.x + Bd @ self.u

    def outputs(self) -> FloatArray:
        return self.C @ self.x + self.D @ self.u

    def state(self) -> FloatArray:
        return self.x.copy()

    def put(self, state: FloatArray) -> None:
        self.x = state.copy()


class Sampler(Scripted):
    """A discrete controller that samples at the beginning of each step: y = C z + D u, then z+ = A z + B u.

    Its outputs are held until its next step. It declares feed-through from every input that D or B lets through,
    as a sampled model does, so that its law is y_k = C z_k + D u_k without delay.
    """

    def __init__(self, name: str, A: Matrix, B: Matrix, C: Matrix, D: Matrix, z0: Sequence[float] = ()) -> None:
        self.A, self.B, self.C, self.D = (np.atleast_2d(each).astype(float) for each in (A, B, C, D))
        self.z0 = np.array(z0 if len(z0) else np.zeros(len(self.A)), dtype=float)
        inputs = [f"u{i}" for i in range(self.D.shape[1])]
        super().__init__(
            name,
            interface(inputs, [f"y{i}" for i in range(len(self.D))], {f"y{i}": inputs for i in range(len(self.D))}),
        )

    def restart(self) -> None:
        self.z = self.z0.copy()
        self.y = np.zeros(len(self.D))

    def advance(self, time: float, duration: float) -> None:
        self.y = self.C @ self.z + self.D @ self.u
        self.z = self.A @ self.z + self.B @ self.u

    def outputs(self) -> FloatArray:
        return self.y

    def state(self) -> tuple[FloatArray, FloatArray]:
        return self.z.copy(), self.y.copy()

    def put(self, state: tuple[FloatArray, FloatArray]) -> None:
        self.z, self.y = state[0].copy(), state[1].copy()


class Gain(Scripted):
    """y = K u + offset, at once, without any state."""

    def __init__(self, name: str, K: Matrix | float, offset: float = 0.0, has_state: bool = True) -> None:
        self.K, self.offset = np.atleast_2d(np.asarray(K, dtype=float)), offset
        inputs = [f"u{i}" for i in range(self.K.shape[1])]
        outputs = [f"y{i}" for i in range(len(self.K))]
        super().__init__(name, interface(inputs, outputs, dict.fromkeys(outputs, inputs), has_state=has_state))

    def outputs(self) -> FloatArray:
        with np.errstate(over="ignore", invalid="ignore"):
            return self.K @ self.u + self.offset


class Clock(Scripted):
    """A source: its output `y` is the time at the end of its step, `factor` times."""

    def __init__(self, name: str, factor: float = 1.0) -> None:
        super().__init__(name, interface(outputs=["y"], parameters={"factor": factor}))

    def restart(self) -> None:
        self.now = 0.0

    def advance(self, time: float, duration: float) -> None:
        self.now = time + duration

    def outputs(self) -> list[float]:
        return [self.values["factor"] * self.now]


def zero_order_hold(A: Matrix, B: Matrix, h: float) -> tuple[Matrix, Matrix]:
    """Ad, Bd of x+ = Ad x + Bd u with u held over h [s], from one matrix exponential."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    exponential = scipy.linalg.expm(block * h)
    return exponential[:n, :n], exponential[:n, n:]


def system(
    components: Sequence[Scripted],
    connections: Iterable[str] = (),
    stimulated: Iterable[str] = (),
    steps: Mapping[str, Fraction] | None = None,
    feed_through: Mapping[str, FeedThrough] | None = None,
) -> System:
    """These components wired by "a.y0 -> b.u0"."""
    parts = {
        each.name: Part(each.interface, (steps or {}).get(each.name), (feed_through or {}).get(each.name, "declared"))
        for each in components
    }
    return wire(parts, [tuple(each.split(" -> ")) for each in connections], stimulated)  # type: ignore[misc]


def simulation(
    components: Sequence[Scripted],
    connections: Iterable[str] = (),
    *,
    step: Fraction = Fraction(1, 10),
    stop: Fraction = Fraction(1),
    start: Fraction = Fraction(0),
    order: Order = Order.GAUSS_SEIDEL,
    engine: Engine = Engine.AUTO,
    cycles: CycleSettings | None = None,
    stimulated: Iterable[str] = (),
    steps: Mapping[str, Fraction] | None = None,
    feed_through: Mapping[str, FeedThrough] | None = None,
) -> Simulation:
    """A simulation of these components."""
    timing = Timing(stop, step, start, order, cycles or REFUSED, engine=engine)
    wired = system(components, connections, stimulated, steps, feed_through)
    return Simulation(wired, {each.name: each for each in components}, timing)
