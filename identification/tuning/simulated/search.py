"""A search on simulated loops: a simplex from each start, begun anew at its end, for runs with friction, noise and
rounding have no slopes that a quadratic program could follow."""

from __future__ import annotations

from identification.tuning.procedures.descent import Seen, rank, simplex
from identification.tuning.procedures.procedure import HELD, Descent, Found
from identification.tuning.procedures.search import Search, led
from identification.tuning.procedures.unknowns import Span
from identification.tuning.simulated.problem import SimulatedProblem
from orchestrator.fmi.interface import Interface
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

SIZES = (0.15, 0.03)  # of the simplex, of the span between the bounds: first, and when it is begun anew


def searched(search: Search, problem: SimulatedProblem, interface: Interface, progress: Progress) -> Found:
    """The best of where all starts lead."""
    spans, points = search.begun(interface)
    return led(spans, points, lambda point: _descent(problem, spans, point, search.evaluations), progress)


def _descent(problem: SimulatedProblem, spans: list[Span], point: FloatArray, evaluations: int) -> Descent:
    """From one start to its end; the best of all that was seen on the way."""
    seen = Seen(problem, spans)
    start = seen(point)
    for size in SIZES:
        merit = seen.penalised(point) if seen(point).most_missed <= HELD else lambda z: seen(z).most_missed
        point = min((point, simplex(merit, point, evaluations, size=size)), key=lambda z: rank(seen(z)))
    best = min(seen.judged, key=rank)
    return Descent(start.values, best, seen.evaluations)
