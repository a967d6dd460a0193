"""What a sweep leaves: the data set, and what it says of all runs together."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NotRequired, TypedDict

import numpy as np
import pyarrow as pa
from pyarrow import compute, dataset, parquet

from fmus.errors import FmuError, InputError
from fmus.files import RawMap
from orchestrator.batch.sweep.runs.folder import RUNS, header
from orchestrator.batch.sweep.runs.rows import FAILED
from orchestrator.batch.sweep.runs.setup import Numbers
from orchestrator.display.table import table
from orchestrator.trace import FloatArray

if TYPE_CHECKING:
    import pandas

SUMMARY = "summary.json"
HEADERS = ("of each run", "held", "95 % sure", "5 % to 95 % of the runs", "worst run")


class AskedDocument(TypedDict):
    """What was asked of each run, and how often it held.

    Attributes:
        column: of its figure; the verdict is in the one that ends in `_held`.
        counts: whether a run passes only where it holds.
        of: runs that were judged.
        share, interval: in which it held, and within which that of all such runs lies, 95 % sure; null without any.
        figure: lowest, quantiles and highest of its figure, null without any.
        worst: number of the run with the smallest margin, null where there is none.
    """

    column: str
    text: str
    unit: str
    counts: bool
    held: int
    of: int
    share: float | None
    interval: list[float] | None
    figure: dict[str, float] | None
    worst: int | None


class SweepDocument(TypedDict):
    """All runs together, as `summary.json` holds it.

    Attributes:
        by_case: how many of each case pass, where there are several with several runs each.
    """

    title: str
    passed: bool
    scenario: str
    runs: int
    points: int
    cases: list[str]
    design: RawMap
    failed: int
    passing: AskedDocument
    by_case: list[AskedDocument]
    asked: list[AskedDocument]
    varied: dict[str, str]
    notes: list[str]
    at_least: NotRequired[float]
    versions: dict[str, str]


@dataclass(frozen=True)
class SweepResult:
    """A sweep that was run.

    Attributes:
        folder: that holds it.
        document: all runs together.
    """

    folder: Path
    document: SweepDocument

    @property
    def passed(self) -> bool:
        """Whether as many runs passed as the study asks for."""
        return self.document["passed"]

    @property
    def sentence(self) -> str:
        """How many runs there were."""
        failed = f"; {self.document['failed']:,} failed, see `reason`" if self.document["failed"] else ""
        return f"{self.document['runs']:,} runs at {self.document['points']:,} points{failed}"

    @property
    def told(self) -> list[AskedDocument]:
        """What is told of all runs together: how many pass, in each case, too, and what was asked of them."""
        return [self.document["passing"], *self.document["by_case"], *self.document["asked"]]

    def rows(self) -> list[tuple[str, ...]]:
        """A row under `HEADERS` of all that was asked."""
        return [_row(one) for one in self.told]

    def _repr_html_(self) -> str:
        return table(HEADERS, self.rows(), caption=f"{self.document['title']}: {self.sentence}")

    @property
    def dataset(self) -> dataset.Dataset:
        """The rows, which need not be in memory."""
        return dataset.dataset(self.folder / RUNS, format="parquet")

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """The rows in the order of the runs; all columns by default."""
        return self.dataset.to_table(columns=None if columns is None else list(columns))

    def frame(self, columns: Sequence[str] | None = None) -> pandas.DataFrame:
        """The same for pandas, which has to be installed."""
        return self.table(columns).to_pandas()

    @property
    def failed(self) -> Numbers:
        """Numbers of the runs that failed."""
        found: Numbers = np.flatnonzero(self._joined("state", lambda states: compute.equal(states, FAILED)))
        return found

    @property
    def failure(self) -> FmuError | None:
        """Why there is nothing to be told of any run, None where one did not fail."""
        if self.document["failed"] < self.document["runs"]:
            return None
        first = parquet.read_table(self._files[0], columns=["reason"])["reason"][0].as_py()
        problem = f"all {self.document['runs']:,} runs failed, the first one so: {first}"
        return FmuError(self.folder, problem, "mend that")

    def sampled(self, columns: Sequence[str], most: int) -> pa.Table:
        """At most so many rows, spread evenly over all; no more than a part of the data set is in memory besides."""
        step = max(1, -(-self.document["runs"] // most))
        found, first = [], 0
        for file in self._files:
            rows = parquet.read_table(file, columns=list(columns))
            found.append(rows.take(np.arange(-first % step, len(rows), step)))
            first += len(rows)
        return pa.concat_tables(found)

    def column(self, name: str) -> FloatArray:
        """(N,) numbers of a column, NaN where a run has none."""
        return self._joined(name, lambda values: values)

    def _joined(self, name: str, change: Callable[[pa.ChunkedArray], pa.ChunkedArray]) -> FloatArray:
        """(N,) a column, changed, part by part: no more than that and a part is in memory."""
        pieces = [np.zeros(0)]
        for file in self._files:
            values = change(parquet.read_table(file, columns=[name])[name]).cast(pa.float64())
            pieces.append(np.asarray(values.to_numpy(zero_copy_only=False), dtype=float))
        return np.concatenate(pieces)

    @property
    def _files(self) -> list[Path]:
        return sorted((self.folder / RUNS).glob("*.parquet"))


def load_result(folder: str | Path) -> SweepResult:
    """The sweep in a folder.

    Raises:
        InputError: it holds none that was ever finished.
    """
    path = Path(folder)
    header(path)
    try:
        document: SweepDocument = json.loads((path / SUMMARY).read_text(encoding="utf-8"))
    except OSError:
        raise InputError(path, "was not finished", "run the study again") from None
    except ValueError as error:
        raise InputError(path / SUMMARY, f"is not JSON ({error})", "run the study again") from None
    return SweepResult(path, document)


def _row(asked: AskedDocument) -> tuple[str, ...]:
    share = "–" if asked["share"] is None else f"{asked['held']:,} of {asked['of']:,}"
    interval = "–" if asked["interval"] is None else "{:.3g} to {:.3g} %".format(*(100 * e for e in asked["interval"]))
    spread = asked["figure"]
    figures = "–" if spread is None else f"{spread['q05']:.4g} to {spread['q95']:.4g} {asked['unit']}".strip()
    return asked["text"], share, interval, figures, "–" if asked["worst"] is None else str(asked["worst"])
