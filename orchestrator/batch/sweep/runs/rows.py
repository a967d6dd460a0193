"""The data set of a sweep as Arrow has it: a row a run, its columns the same in every part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from orchestrator.batch.sweep.points.designs import seed_of
from orchestrator.batch.sweep.points.factors import Factor
from orchestrator.batch.sweep.runs.setup import Chunk, Setup
from orchestrator.scenario.expectations import Check
from orchestrator.trace import FloatArray

HELD, MARGIN = "_held", "_margin"
FIRST = ("run", "point", "case")
STATE = ("state", "reason", "passed")
TIME = "time"
DONE, ENDED, FAILED = "done", "ended", "failed"


@dataclass(frozen=True)
class Row:
    """What came of a run.

    Attributes:
        state: `DONE`; `ENDED`, where an FMU asked to stop before the end; or `FAILED`.
        reason: why it ended or failed.
        checks: number of a column of figures -> how it turned out.
        trace: stamps and samples that are kept, each (k,); None where there are none.
    """

    state: str
    reason: str | None
    passed: bool
    checks: dict[int, Check]
    trace: Sequence[FloatArray] | None = None


def schema(setup: Setup) -> pa.Schema:
    """Names, types, units and texts of the columns."""
    fields = [pa.field("run", pa.int64()), pa.field("point", pa.int64()), pa.field("case", pa.string())]
    fields += [_field(factor.name, _type(factor), factor.unit) for factor in setup.space.factors]
    fields += [pa.field(f"{name}.seed", pa.int64()) for name in setup.noise]
    fields += [pa.field("state", pa.string()), pa.field("reason", pa.string()), pa.field("passed", pa.bool_())]
    for asked in setup.asked:
        fields.append(_field(asked.name, pa.float64(), asked.unit, asked.text))
        fields.append(pa.field(asked.name + HELD, pa.bool_()))
        fields.append(_field(asked.name + MARGIN, pa.float64(), asked.unit))
    if setup.kept is not None:
        fields.append(_field(TIME, pa.list_(pa.float64()), "s"))
        pairs = zip(setup.kept.signals, setup.kept.units, strict=True)
        fields += [_field(name, pa.list_(pa.float64()), unit) for name, unit in pairs]
    return pa.schema(fields)


def table(setup: Setup, task: Chunk, rows: Sequence[Row]) -> pa.Table:
    """The rows of a task."""
    points, cases = np.divmod(task.runs, len(setup.cases))
    columns: list[Any] = [task.runs, points, [setup.cases[case] for case in cases]]
    columns += [values_of(factor, task.points[:, place]) for place, factor in enumerate(setup.space.factors)]
    columns += [[seed_of(setup.seed, int(p), number) for p in points] for number in range(len(setup.noise))]
    columns += [[row.state for row in rows], [row.reason for row in rows], [row.passed for row in rows]]
    for number in range(len(setup.asked)):
        checks = [row.checks.get(number) for row in rows]
        columns.append([None if check is None else check.figure for check in checks])
        columns.append([None if check is None else check.held for check in checks])
        columns.append([None if check is None else check.margin for check in checks])
    if setup.kept is not None:
        columns += [_lists([row.trace for row in rows], place) for place in range(len(setup.kept.signals) + 1)]
    known = schema(setup)
    arrays = [
        column if isinstance(column, pa.Array) else pa.array(column, field.type)
        for column, field in zip(columns, known, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=known)


def packed(rows: pa.Table) -> bytes:
    """Rows as they travel."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema) as writer:
        writer.write_table(rows)
    found: bytes = sink.getvalue().to_pybytes()
    return found


def unpacked(data: bytes) -> pa.Table:
    """The rows again."""
    with pa.ipc.open_stream(data) as reader:
        return reader.read_all()


def _field(name: str, kind: pa.DataType, unit: str = "", text: str = "") -> pa.Field:
    facts = {key: value for key, value in (("unit", unit), ("text", text)) if value}
    return pa.field(name, kind, metadata=facts or None)


def _type(factor: Factor) -> pa.DataType:
    if factor.words:
        return pa.string()
    return {None: pa.float64(), int: pa.int64(), bool: pa.bool_()}[factor.whole]


def values_of(factor: Factor, numbers: FloatArray) -> pa.Array:
    """The column of a factor at points that have these numbers (N,) of it."""
    if factor.words:
        return pa.array([factor.words[int(number)] for number in numbers], pa.string())
    given = numbers if factor.whole is None else [factor.whole(number) for number in numbers]
    return pa.array(given, _type(factor))


def _lists(traces: Sequence[Sequence[FloatArray] | None], place: int) -> pa.Array:
    """A column of lists, null where there is no trace."""
    ends = np.cumsum([0, *(0 if trace is None else len(trace[place]) for trace in traces)])
    offsets = pa.array(ends, pa.int32(), mask=np.array([*(trace is None for trace in traces), False]))
    samples = [trace[place] for trace in traces if trace is not None]
    return pa.ListArray.from_arrays(offsets, pa.array(np.concatenate(samples) if samples else np.zeros(0)))
