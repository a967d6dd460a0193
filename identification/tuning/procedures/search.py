"""A search for a controller's parameters: from several starts, within bounds, under hard goals (Eq. 4-3).

Where no point holds all hard goals the one that misses least is taken, and the goals that bind there are told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.tuning.procedures.descent import descent, rank
from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from identification.tuning.procedures.procedure import HELD, Descent, Found
from identification.tuning.procedures.trade_off import trades
from identification.tuning.procedures.unknowns import Span, Unknown, parts
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Interface, Port
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

ROUNDS = 12  # of a search with draws
AT_ONCE = 4  # draws that join it in a round
TOGETHER = 1e-3  # of the span between the bounds, within which two optima are one


@dataclass(frozen=True)
class Search:
    """A search over parameters of the controller.

    Attributes:
        unknowns: the controller's parameter -> its bounds.
        starts: points to start from, each parameter -> value, over the unknowns' own; in their units.
        more: how many further starts are drawn between the bounds.
        seed: of the starts that are drawn.
        evaluations: the most that a simplex may take.
    """

    unknowns: Mapping[str, Unknown]
    starts: tuple[Mapping[str, float | str], ...] = ()
    more: int = 0
    seed: int = 0
    evaluations: int = 60

    def sized(self, controller: ComponentSpec, plants: Mapping[str, LinearModel]) -> ComponentSpec:
        """The controller as it is: its arrays are the study's."""
        return controller

    def check(self, interface: Interface) -> None:
        """See that the unknowns are parameters of the controller.

        Raises:
            InputError: one is not, or its bounds are none.
        """
        self.points(interface)

    def run(self, problem: TuningProblem, interface: Interface, progress: Progress) -> Found:
        """The best of where all starts lead."""
        spans, points = self.begun(interface)
        found = led(spans, points, lambda point: descent(problem, spans, point, self.evaluations), progress)
        best, drawn, searched = found.best, None, problem
        if problem.draws is not None:
            best, drawn, searched = _with_draws(problem, spans, best, points, self.evaluations, progress)
        cost = trades(searched, spans, searched.judged(best.values), progress)
        return replace(found, best=best, drawn=drawn, share=problem.share, trades=cost)

    def begun(self, interface: Interface) -> tuple[list[Span], list[FloatArray]]:
        """The spans of the unknowns and all starts, those that are drawn, too."""
        spans, points = self.points(interface)
        rng = np.random.default_rng(self.seed)
        return spans, points + [rng.uniform(0, 1, len(spans)) for _ in range(self.more)]

    def points(self, interface: Interface) -> tuple[list[Span], list[FloatArray]]:
        """The unknowns in numbers, and the given starts between their bounds."""
        ports = [_port(interface, name) for name in self.unknowns]
        spans = [unknown.span(port) for unknown, port in zip(self.unknowns.values(), ports, strict=True)]
        points = []
        for number, given in enumerate(self.starts or ({},)):
            values = []
            for span, port in zip(spans, ports, strict=True):
                place = f"starts.{number}.{span.name}"
                value = port.number(place, given[span.name]) if span.name in given else span.start
                if not span.low <= value <= span.high:
                    raise IdentificationError(place, f"is {value:g}, outside [{span.low:g}, {span.high:g}]", "move it")
                values.append(span.part(value))
            points.append(np.array(values))
        return spans, points


def _port(interface: Interface, name: str) -> Port:
    """A real parameter of the controller."""
    port = interface.ports.get(name)
    if port is None or port.causality != "parameter" or not port.real:
        known = ", ".join(p.name for p in interface.of("parameter") if p.real and p.array is None)
        raise IdentificationError(f"unknowns.{name}", "is no real parameter of the controller", f"there are {known}")
    return port


def _with_draws(
    problem: TuningProblem,
    spans: Sequence[Span],
    best: CandidateJudgement,
    points: Sequence[FloatArray],
    evaluations: int,
    tell: Progress,
) -> tuple[CandidateJudgement, CandidateJudgement, TuningProblem]:
    """The best values with which enough draws hold the hard goals, too, and what all draws do to these goals.

    Only those draws stand in the search that have spoilt an earlier round's values: a handful decides. It goes on from
    there, and from the first start, since what was best without draws may be far off. The problem with these draws
    comes back, too.
    """
    assert problem.draws is not None
    hard = tuple(goal for goal in problem.goals if goal.hard and not goal.minimised)
    every, active = replace(problem.on(problem.draws), goals=hard), list[int]()
    count = len(every.plants)
    allowed = int((1 - problem.share) * count + 1e-9)
    drawn, some = every.judged(best.values), problem
    for turn in range(ROUNDS):
        tell(turn / ROUNDS, f"{count} draws, {len(active)} in the search")
        misses = drawn.misses
        worst = np.argsort(-misses, kind="stable")[allowed:]
        new = [int(i) for i in worst[:AT_ONCE] if misses[i] > HELD and i not in active]
        if not new:
            break
        active += new
        some, from_best = problem.with_draws(active), parts(spans, best.values)
        found = [descent(some, spans, point, evaluations).found for point in (from_best, points[0])]
        best = problem.judged(min(found, key=rank).values)
        drawn = every.judged(best.values)
    return best, drawn, some


def led(
    spans: Sequence[Span], points: Sequence[FloatArray], descend: Callable[[FloatArray], Descent], progress: Progress
) -> Found:
    """The best of where all starts lead."""
    descents = []
    for number, point in enumerate(points):
        progress(number / len(points), f"start {number + 1} of {len(points)}")
        descents.append(descend(point))
    best = min((descent.found for descent in descents), key=rank)
    starts = {span.name: descents[0].start[span.name] for span in spans}
    return Found(best, starts, tuple(descents), agreeing(spans, descents, best))


def agreeing(unknowns: Sequence[Span], descents: Sequence[Descent], best: CandidateJudgement) -> int:
    """How many of them led to the best values."""
    there = parts(unknowns, best.values)
    return sum(bool(np.abs(parts(unknowns, d.found.values) - there).max() <= TOGETHER) for d in descents)
