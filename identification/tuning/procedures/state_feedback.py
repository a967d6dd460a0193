"""State feedback from an observer, step by step (the flexible-manipulator thesis, Section 4.4, Figs. 4-13 and 4-14).

Weights give the feedback K, by duality others give the observer L from what is measured, a steady state gives kp, and a
search on what the study asks, such as the response to a disturbance, ki. One plant is the one of the design, all judge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.errors import IdentificationError
from fmus.library import find
from fmus.modelling.model import Model
from identification.linear.model import UNIT_CIRCLE, LinearModel
from identification.tuning.procedures.problem import TuningProblem
from identification.tuning.procedures.procedure import Found
from identification.tuning.procedures.riccati import observer, regulator, unreached, unseen
from identification.tuning.procedures.search import Search
from identification.tuning.procedures.weights import Weights, weight
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Interface
from orchestrator.progress import Progress
from orchestrator.trace import ComplexArray, FloatArray

MATRICES = ("A", "B", "C", "K", "L")
FASTER = 2.0  # than the feedback, which an observer is to be (Section 4.4, step 2)
SETTLED = 1e-12  # of a step, what is left of it where its steady state is read
LONGEST = 1_000_000  # samples of a step
Gains = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
ALIKE = 1e-6  # relative, how far both figures of kp may be apart


@dataclass(frozen=True)
class StateFeedback:
    """The design.

    Attributes:
        weights: of the states, or the plant's outputs, and of the command, for K.
        observer: of the states' noise, or of the plant's inputs, and of what is measured, for L.
        faster: times the slowest pole of the feedback, at which all of the observer's fade at least; the weights alone
            decide without.
        plant: the one of the design, the first by default.
        integral: the search for ki; None leaves it.
    """

    weights: Weights = field(default_factory=Weights)
    observer: Weights = field(default_factory=Weights)
    faster: float | None = None
    plant: str | None = None
    integral: Search | None = None

    def sized(self, controller: ComponentSpec, plants: Mapping[str, LinearModel]) -> ComponentSpec:
        """The controller with arrays of the plant's order, where the study gives it none."""
        order, source = self._chosen(plants)[1].order, controller.source
        if controller.fmu is None and "A" in (source if isinstance(source, Model) else find(str(source))).arrays:
            return replace(controller, arrays={"A": (order, order), **controller.arrays})
        return controller

    def check(self, interface: Interface) -> None:
        """See that the controller is a state feedback from an observer.

        Raises:
            IdentificationError: it lacks an array or gain.
        """
        for name in MATRICES:
            if interface.shape(name) is None:
                raise IdentificationError("controller", f"has no array {name}", "take a state feedback, such as ilqr")
        for name in ("kp", "ki"):
            if name not in interface.ports:
                raise IdentificationError("controller", f"has no gain {name}", "take a state feedback, such as ilqr")
        if self.integral is not None:
            self.integral.check(interface)

    def run(self, problem: TuningProblem, interface: Interface, progress: Progress) -> Found:
        """The gains, and how they do with all plants."""
        name, model = self._chosen(problem.models)
        progress(0.0, "gains")
        loop = _Loop.of(name, model, problem)
        loop.require_size(interface)
        gains, rates = self._gains(loop)
        values = loop.values(*gains)
        closed, kp = _feed_forward(name, loop, gains[0]), _measured(problem, model, values, rates)
        values |= {"kp": closed}
        figures = {
            "kp in closed form": closed,
            "kp measured in a run": kp,
            "rate of the observer over that of the feedback": rates[1] / rates[0],
        }
        remarks = _remarks(figures)
        if self.integral is None:
            drawn = None if problem.draws is None else problem.on(problem.draws).judged(values)
            best = problem.judged(values)
            return Found(best, {}, (), 1, remarks, drawn, problem.share, figures)
        searched = self.integral.run(replace(problem, held=values), interface, progress)
        best = problem.judged({**values, **searched.best.values})
        figures["ki a sample"] = best.values["ki"] * model.step
        return replace(searched, best=best, remarks=(*remarks, *searched.remarks), figures=figures)

    def _chosen(self, plants: Mapping[str, LinearModel]) -> tuple[str, LinearModel]:
        name = next(iter(plants)) if self.plant is None else self.plant
        if name not in plants:
            raise IdentificationError("design.plant", f"'{name}' is no plant", f"there are {', '.join(plants)}")
        return name, plants[name]

    def _gains(self, loop: _Loop) -> tuple[tuple[FloatArray, FloatArray], tuple[float, float]]:
        """K and L, and the rate at which the slowest pole of each fades [1 a sample]."""
        a, b, c, model = loop.a, loop.b, loop.c, loop.model
        n, p = model.order, len(c)
        outputs = dict(zip(model.outputs, model.c, strict=True))
        inputs = dict(zip(model.inputs, model.b.T, strict=True))
        q = weight("design.weights.Q", self.weights.q, n, outputs)
        r = weight("design.weights.R", self.weights.r, 1, {loop.command: np.ones(1)}, definite=True)
        v = weight("design.observer.Q", self.observer.q, n, inputs)
        w = weight("design.observer.R", self.observer.r, p, dict(zip(loop.sensors, np.eye(p), strict=True)), True)
        _require_marginal("design.weights.Q", unseen(a, q), "weights")
        k = _stabilising("design.weights", regulator, a, b, q, r)
        rate = _rate(a - b @ k)
        ahead = np.exp(0.0 if self.faster is None else self.faster * rate)
        _require_marginal("design.observer.Q", unreached(ahead * a, v), "noise")
        gain = _stabilising("design.observer", observer, ahead * a, ahead * c, v, w)
        return (k, gain), (rate, _rate(a - gain @ c))


@dataclass(frozen=True, eq=False)
class _Loop:
    """The plant as the controller sees it.

    Attributes:
        a, b, c: (n, n), (n, 1) from the controller's command, (p, n) to the controller's measured inputs.
        tracked: (n,) of what is tracked.
        command: the plant's input; sensors: the controller's inputs, in their order.
    """

    model: LinearModel
    b: FloatArray
    c: FloatArray
    tracked: FloatArray
    command: str
    sensors: tuple[str, ...]

    @property
    def a(self) -> FloatArray:
        return self.model.a

    @classmethod
    def of(cls, name: str, model: LinearModel, problem: TuningProblem) -> _Loop:
        """The plant of this name."""
        wiring = problem.wiring
        commands, targets = ({getattr(path, end) for path in wiring.commanded} for end in ("source", "target"))
        if len(commands) != 1 or len(targets) != 1:
            raise IdentificationError("connections", "have several commands", "join one, as a state feedback has it")
        inputs = sorted({path.target for path in wiring.measured})
        b, c = model.b @ wiring.acting[:, [*commands]], wiring.sensing[inputs] @ model.c
        for poles, what in ((unreached(model.a, b), "reached by the command"), (unseen(model.a, c), "seen")):
            if len(poles):
                lacking = f"has the pole {poles[0]:.6g}, which is not {what}"
                raise IdentificationError(f"plants.{name}", lacking, "reduce the model, without that mode")
        sensors = tuple(problem.controller.inputs[number] for number in inputs)
        return cls(model, b, c, model.c[wiring.tracked], model.inputs[targets.pop()], sensors)

    def require_size(self, interface: Interface) -> None:
        """See that the controller's arrays are of the plant's order and have a row for what is connected."""
        n, p = self.model.order, len(self.c)
        found, rows = interface.shape("A") or (), interface.shape("C") or ()
        if found[:1] != (n,):
            problem = f"is for a model of order {found[0] if found else 0}, and the plant of the design is of order {n}"
            raise IdentificationError("controller", problem, "leave its arrays out: they come of the design")
        if rows[:1] != (p,):
            problem = f"takes {rows[0]} measurements, and {p} are connected ({', '.join(self.sensors)})"
            raise IdentificationError("connections", problem, "connect all of them")

    def values(self, k: FloatArray, gain: FloatArray) -> dict[str, float]:
        """The controller's arrays, element by element."""
        arrays = dict(zip(MATRICES, (self.a, self.b, self.c, k, gain), strict=True))
        return {
            f"{name}[{i + 1},{j + 1}]": float(matrix[i, j])
            for name, matrix in arrays.items()
            for i, j in np.ndindex(*matrix.shape)
        }


def _stabilising(place: str, gains: Gains, a: FloatArray, b: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """The gains by these weights."""
    fix = "weight all modes that hardly fade, and scale the states alike"
    try:
        found = gains(a, b, q, r)
    except np.linalg.LinAlgError as error:
        raise IdentificationError(place, f"has no stabilising gains ({error})", fix) from None
    if not _rate(a - (b @ found if gains is regulator else found @ b)) > 0:
        raise IdentificationError(place, "has no stabilising gains, but for rounding", fix)
    return found


def _rate(a: FloatArray) -> float:
    """At which the slowest mode fades [1 a sample]."""
    return float(-np.log(max(np.abs(np.linalg.eigvals(a)).max(), 1e-300)))


def _require_marginal(place: str, poles: ComplexArray, what: str) -> None:
    """See that none of the poles that weights leave out is on the unit circle: it would stay there."""
    for pole in poles:
        if 1 / UNIT_CIRCLE < abs(pole) < UNIT_CIRCLE:
            problem = f"has no {what} on the mode with the pole {pole:.6g}, which does not fade by itself"
            raise IdentificationError(place, problem, "give it some")


def _feed_forward(name: str, loop: _Loop, k: FloatArray) -> float:
    """kp in closed form, with which what is tracked comes to the reference without an integral."""
    rest = np.linalg.solve(np.eye(len(loop.a)) - loop.a + loop.b @ k, loop.b)
    gain, size = float((loop.tracked @ rest)[0]), float(np.linalg.norm(loop.tracked) * np.linalg.norm(rest))
    if abs(gain) <= 1e-12 * size:
        problem = "gives nothing of a constant command to what is tracked"
        raise IdentificationError(f"plants.{name}", problem, "track another output")
    return 1.0 / gain


def _measured(
    problem: TuningProblem, model: LinearModel, values: Mapping[str, float], rates: tuple[float, float]
) -> float:
    """kp of a run: a step of 1 with kp 1 and ki 0, over where it ends (Section 4.4, step 3)."""
    assert problem.bench is not None
    samples = min(int(np.log(1 / SETTLED) / min(rates)) + 2 * model.order + 2, LONGEST)
    followed = problem.bench.followed(model, {**values, "kp": 1.0, "ki": 0.0}, 1.0, samples)
    return float(1.0 / followed[-1])


def _remarks(figures: Mapping[str, float]) -> tuple[str, ...]:
    closed, kp, faster = figures.values()
    found = []
    if faster < FASTER:
        found.append(f"the observer fades {faster:.3g} times as fast as the state feedback; {FASTER:g} are usual")
    if not abs(kp - closed) <= ALIKE * abs(closed):
        found.append(f"kp is {closed:.8g} in closed form and {kp:.8g} in a run, where it may be limited")
    return tuple(found)
