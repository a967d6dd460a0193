"""All runs of a sweep together: how often what was asked held, and how its figures are spread."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fmus.files import atomic_write
from fmus.json_document import json_text
from orchestrator.batch.sweep.runs.preparation import PreparedSweep
from orchestrator.batch.sweep.runs.rows import HELD, MARGIN
from orchestrator.batch.sweep.runs.setup import Asked
from orchestrator.batch.sweep.told.result import SUMMARY, AskedDocument, SweepDocument, SweepResult
from orchestrator.measures.share import share_interval
from orchestrator.results import versions
from orchestrator.trace import FloatArray

QUANTILES = {"q05": 0.05, "median": 0.5, "q95": 0.95}
PASSED = Asked("passed", "passes: all that its case expects holds")


def write_summary(study: PreparedSweep, folder: Path) -> SweepResult:
    """The result of a study that is done, with its `summary.json`."""
    found = SweepResult(folder, {})  # type: ignore[typeddict-item]
    document = _document(study, found)
    atomic_write(folder / SUMMARY, json_text(document).encode())
    return SweepResult(folder, document)


def _document(study: PreparedSweep, found: SweepResult) -> SweepDocument:
    setup, block = study.setup, study.block
    passed = found.column("passed")
    passing = asked_of(PASSED, passed, None, None)
    failed = len(found.failed)
    document: SweepDocument = {
        "title": block.title,
        "passed": block.at_least is None or (passing["share"] or 0.0) >= block.at_least,
        "scenario": str(block.sweep),
        "runs": study.runs,
        "points": study.design.count,
        "cases": list(setup.cases),
        "design": block.design.model_dump(mode="json", exclude={"points"}, exclude_none=True),
        "failed": failed,
        "passing": passing,
        "by_case": _by_case(setup.cases, passed),
        "asked": [_asked(found, one) for one in setup.asked],
        "varied": {factor.name: factor.unit for factor in setup.space.factors},
        "notes": list(study.notes),
        "versions": versions(),
    }
    return document if block.at_least is None else document | {"at_least": block.at_least}


def _by_case(cases: Sequence[str], passed: FloatArray) -> list[AskedDocument]:
    """Verdicts (N,) of each case, whose runs come one after the other at each point."""
    if len(cases) < 2 or len(passed) == len(cases):
        return []
    return [
        asked_of(Asked("passed", f"passes in case {name}"), passed[number :: len(cases)], None, None)
        for number, name in enumerate(cases)
    ]


def _asked(found: SweepResult, asked: Asked) -> AskedDocument:
    held, figures = found.column(asked.name + HELD), found.column(asked.name)
    return asked_of(asked, held, figures, found.column(asked.name + MARGIN))


def asked_of(asked: Asked, held: FloatArray, figures: FloatArray | None, margins: FloatArray | None) -> AskedDocument:
    """What is told of verdicts (N,), figures (N,) and margins (N,)."""
    of, count = int(np.isfinite(held).sum()), int(np.nansum(held))
    interval = list(share_interval(count, of)) if of else None
    return {
        "column": asked.name,
        "text": asked.text,
        "unit": asked.unit,
        "counts": asked.counts,
        "held": count,
        "of": of,
        "share": count / of if of else None,
        "interval": interval,
        "figure": None if figures is None else _spread(figures[np.isfinite(figures)]),
        "worst": None if margins is None or not np.isfinite(margins).any() else int(np.nanargmin(margins)),
    }


def _spread(figures: FloatArray) -> dict[str, float] | None:
    if not len(figures):
        return None
    quantiles = np.quantile(figures, list(QUANTILES.values()), overwrite_input=True).tolist()
    ends = {"lowest": float(figures.min()), "highest": float(figures.max()), "mean": float(figures.mean())}
    return {**ends, "std": float(figures.std()), **dict(zip(QUANTILES, quantiles, strict=True))}
