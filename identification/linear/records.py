"""Records of inputs and outputs at one sampling time, from which linear models are estimated.

Gaps are cut out here, and what does not fit together is refused, so that estimators only see whole records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError, TraceError
from orchestrator.marks import runs
from orchestrator.trace import FloatArray, Trace, read_only

_JITTER = 0.01  # of a step; stamps further off their place are no longer evenly sampled
_SAME_STEP = 1e-6
_SAME_RATE = 1e-4  # of a step, by which records that are judged may be sampled otherwise: clocks drift
_LARGEST = 1e100


@dataclass(frozen=True, eq=False, repr=False)
class InputOutputData:
    """What went in and what came out, sample by sample; read-only, and equal only to itself.

    Attributes:
        u: (K, m) inputs, one column an input; (K,) is taken as one column.
        y: (K, p) outputs; NaN in either array is a gap.
        step: sampling time [s].
        inputs, outputs: names of the columns; u1, u2, ... and y1, y2, ... when not given.
        name: where it comes from, for messages.

    Raises:
        IdentificationError: the sizes do not fit each other, or the step is not positive.
    """

    u: FloatArray
    y: FloatArray
    step: float
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    name: str = "record"

    def __post_init__(self) -> None:
        for field, names, letter in (("u", "inputs", "u"), ("y", "outputs", "y")):
            columns = read_only(getattr(self, field))
            columns = columns[:, None] if columns.ndim == 1 else columns
            given = tuple(getattr(self, names)) or tuple(f"{letter}{i + 1}" for i in range(columns.shape[-1]))
            object.__setattr__(self, field, columns)
            object.__setattr__(self, names, given)
            if columns.ndim != 2 or columns.shape[1] != len(given) or not given:
                raise IdentificationError(
                    self.name, f"{field} is {columns.shape} for {len(given)} {names}", "give one column a name"
                )
        if len(self.u) != len(self.y):
            raise IdentificationError(self.name, f"{len(self.u)} inputs for {len(self.y)} outputs", "sample them alike")
        if not 0 < self.step < np.inf:
            raise IdentificationError(self.name, f"a step of {self.step:g} s", "give the sampling time in seconds")

    def __len__(self) -> int:
        return len(self.u)

    def free_run(self, y: FloatArray) -> Trace:
        """Outputs (K, p), of a model or its own, from 0 s on."""
        time = self.step * np.arange(len(self), dtype=float)
        return Trace(time, dict(zip(self.outputs, y.T, strict=True)), {}, self.name)

    @classmethod
    def of(cls, trace: Trace, inputs: Sequence[str], outputs: Sequence[str]) -> InputOutputData:
        """These signals of a trace.

        Raises:
            TraceError: a signal is missing, or the stamps are not even.
        """
        if len(trace) < 2:
            raise TraceError(trace.name, f"holds {len(trace)} samples", "give a recording")
        step = trace.duration / (len(trace) - 1)
        worst = float(np.max(np.abs(trace.time - trace.time[0] - step * np.arange(len(trace)))))
        if worst > _JITTER * step:
            raise TraceError(trace.name, f"stamps are up to {worst / step:.2g} steps off an even grid", "resample it")
        u, y = (np.column_stack([trace[name] for name in names]) for names in (inputs, outputs))
        return cls(u, y, step, tuple(inputs), tuple(outputs), trace.name)

    def __repr__(self) -> str:
        columns = f"{', '.join(self.inputs)} to {', '.join(self.outputs)}"
        return f"<InputOutputData {self.name}: {columns}, {len(self)} samples every {self.step:g} s>"

    def rows(self, start: int, stop: int) -> InputOutputData:
        """The samples start <= k < stop."""
        return replace(self, u=self.u[start:stop], y=self.y[start:stop])


Records = InputOutputData | Sequence[InputOutputData]  # one, or several that one model is found from


@dataclass(frozen=True, eq=False)
class RecordPieces:
    """Records without gaps.

    Attributes:
        records: at least one.
        dropped: how many pieces were too short, and left out.
        lost: samples in them.
    """

    records: tuple[InputOutputData, ...]
    dropped: int = 0
    lost: int = 0

    @property
    def samples(self) -> int:
        """Of all records together."""
        return sum(map(len, self.records))


def without_gaps(records: Records, shortest: int) -> RecordPieces:
    """The records cut where a sample is not finite; pieces below `shortest` samples are dropped and counted.

    Raises:
        IdentificationError: the records differ in step or columns, no piece is long enough, or a value is so large
            that its square overflows.
    """
    given = (records,) if isinstance(records, InputOutputData) else tuple(records)
    if not given:
        raise IdentificationError("records", "there are none", "give at least one")
    for other in given[1:]:
        _check_alike(given[0], other)
    pieces = [piece for whole in given for piece in between_gaps(whole)]
    kept = tuple(piece for piece in pieces if len(piece) >= shortest)
    if not kept:
        longest = max(map(len, pieces), default=0)
        raise IdentificationError(
            given[0].name,
            f"the longest piece without a gap has {longest} samples, {shortest} are needed",
            "use a smaller block or a longer record",
        )
    for piece in kept:
        largest = max(float(np.abs(piece.u).max()), float(np.abs(piece.y).max()))
        if not largest < _LARGEST:
            raise IdentificationError(piece.name, f"holds a value of {largest:g}", "repair it, or change the unit")
    lost = sum(map(len, pieces)) - sum(map(len, kept))
    return RecordPieces(kept, len(pieces) - len(kept), lost)


def between_gaps(whole: InputOutputData) -> list[InputOutputData]:
    """The longest runs of finite samples, named by where they begin unless that is all."""
    finite = np.asarray(np.isfinite(np.hstack([whole.u, whole.y])).all(axis=1))
    if finite.all():
        return [whole]
    named = ((f"{whole.name} from {first * whole.step:.6g} s", first, after) for first, after in runs(finite))
    return [replace(whole.rows(first, after), name=name) for name, first, after in named]


def check_rate(records: Sequence[InputOutputData], step: float, whose: str) -> None:
    """See that records are sampled as a model steps, or as what it is from is.

    Raises:
        IdentificationError: one is not; a free run along it would be one at another speed.
    """
    for record in records:
        if abs(record.step - step) > _SAME_RATE * step:
            raise IdentificationError(
                record.name, f"is sampled every {record.step:g} s, {whose} every {step:g} s", f"give `sample: {step:g}`"
            )


def checked_weights(weights: Sequence[float], outputs: Sequence[str]) -> FloatArray:
    """(p,) one a output, as an array.

    Raises:
        IdentificationError: they are not as many, or not positive.
    """
    found = np.array(weights, dtype=float)
    if found.shape != (len(outputs),) or not np.all((found > 0) & np.isfinite(found)):
        raise IdentificationError(
            "weights", f"{tuple(weights)} for {len(outputs)} outputs", "give each output a positive one"
        )
    return found


def _check_alike(first: InputOutputData, other: InputOutputData) -> None:
    if abs(other.step - first.step) > _SAME_STEP * first.step:
        raise IdentificationError(
            other.name,
            f"is sampled every {other.step:g} s, {first.name} every {first.step:g} s",
            "resample them to one step",
        )
    if (other.inputs, other.outputs) != (first.inputs, first.outputs):
        raise IdentificationError(
            other.name,
            f"has columns {other.inputs} and {other.outputs}, not {first.inputs} and {first.outputs}",
            "give all records the same columns",
        )
