"""Whether rows that are there are at the points of the study: a list may have changed, or a library that draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from fmus.errors import InputError
from orchestrator.batch.sweep.points.designs import PointDesign
from orchestrator.batch.sweep.runs.rows import values_of
from orchestrator.batch.sweep.runs.setup import Setup


@dataclass(frozen=True)
class SamePoints:
    """See `folder.Same`."""

    setup: Setup
    design: PointDesign

    @property
    def columns(self) -> Sequence[str]:
        """Those of the factors."""
        return self.setup.space.names

    def check(self, file: Path, rows: pa.Table) -> None:
        """See that rows are at the points of the design.

        Raises:
            InputError: one is not; the message names its run.
        """
        points = rows["run"].to_numpy() // len(self.setup.cases)
        first = int(points[0])
        wanted = self.design.points(first, int(points[-1]) + 1)[points - first]
        for place, factor in enumerate(self.setup.space.factors):
            known = pa.chunked_array([values_of(factor, wanted[:, place])])
            if not rows[factor.name].equals(known):
                row = int(np.argmin([a == b for a, b in zip(rows[factor.name], known, strict=True)]))
                problem = (
                    f"has {factor.name} {rows[factor.name][row]} at run {rows['run'][row]}, the study {known[row]}"
                )
                raise InputError(file, problem, "give another --out, or --force to begin anew")
