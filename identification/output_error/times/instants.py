"""At which instants free runs are compared: at the samples of a recording, or at every step where these are closer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from fmus.errors import TraceError
from identification.output_error.times.delays import Delay, HeldCommand, compared_rows, estimated, known
from orchestrator.trace import FloatArray, ReadOnlyArrays, Trace

if TYPE_CHECKING:
    from identification.output_error.study import FreeRunSpec, TraceSignal
    from identification.recordings.campaign import StudyTrace

_AS_SELDOM = 0.95  # steps between samples: closer ones are read at the steps
_TOGETHER = 1e-6  # of a step: what is so near to one is at it


@dataclass(frozen=True, eq=False)
class Instants(ReadOnlyArrays):
    """When outputs are compared, with what, and what delays free runs have to bring themselves.

    Attributes:
        at: (K',) the instants, in steps from the run's beginning.
        delays: of the outputs, None where stamps are corrected.
        measured: (K', m) what is recorded then.
    """

    at: FloatArray
    delays: tuple[Delay | None, ...]
    measured: FloatArray


def at_own_samples(recorded: StudyTrace, step: Fraction) -> bool:
    """Whether a recording comes as seldom as steps [s], or more so; a trace does not tell which samples frames are."""
    return not recorded.held and recorded.trace.interval > _AS_SELDOM * float(step)


def every_step(delays: Sequence[Delay | None], step: Fraction, count: int) -> FloatArray:
    """(K',) those of a run's `count` instants whose outputs lie within it for every delay that is a parameter."""
    return np.array(range(count)[compared_rows(estimated(delays), step, count)], np.float64)


def read_at_steps(run: FreeRunSpec, trace: Trace, start: float, count: int) -> Instants:
    """A recording at the instants of a run from `start` [s]."""
    at, outputs = every_step(run.late, run.step, count), run.outputs.values()
    time = np.asarray(start + at * float(run.step))
    measured = [sampled(trace, spec, time, known(spec.delay)) for spec in outputs]
    return Instants(at, estimated(spec.delay for spec in outputs), np.column_stack(measured))


def own_samples(run: FreeRunSpec, trace: Trace, start: float, count: int) -> Instants:
    """The samples of a recording whose outputs lie within a run of `count` instants from `start` [s] for every delay.

    One known delay of all outputs corrects stamps; of several ones free runs bring each.

    Raises:
        TraceError: fewer than two are left.
    """
    late, outputs = run.late, run.outputs.values()
    alike = len({known(delay) for delay in late}) == 1
    corrected, delays = (known(late[0]), estimated(late)) if alike else (0.0, tuple(late))
    at = (trace.time - corrected - start) / float(run.step)
    at = np.where(np.abs(at - np.rint(at)) < _TOGETHER, np.rint(at), at)
    rows = compared_rows(delays, run.step, count)
    first, after = np.searchsorted(at, rows.start), np.searchsorted(at, rows.stop - 1, side="right")
    if after - first < 2:
        raise TraceError(
            trace.name,
            f"has a sample every {trace.interval:.3g} s, fewer than two in the window from {start:g} s",
            "lengthen the windows, or skip that part",
        )
    measured = [spec.conversion(trace[spec.signal][first:after]) for spec in outputs]
    return Instants(at[first:after], delays[: len(outputs)], np.column_stack(measured))


def sampled(trace: Trace, spec: TraceSignal, instants: FloatArray, delay: float) -> FloatArray:
    """(K,) what the trace shows of a variable at these instants [s], that much later; its ends last."""
    if spec.stepwise:
        return HeldCommand(trace.time, spec.conversion(trace[spec.signal])).at(instants + delay)
    return np.asarray(np.interp(instants + delay, trace.time, spec.conversion(trace[spec.signal])))
