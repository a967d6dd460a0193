"""Tuning: a controller's values for plants and goals."""

from __future__ import annotations

from pathlib import Path

from identification.method import Method
from identification.tuning.report.page import report
from identification.tuning.schema import TuneBlock
from identification.tuning.summary import calibrated, summary
from identification.tuning.tuning import Tuning, tune
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(block: TuneBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None) -> Tuning:
    return tune(block.study(base), progress, isolation)


METHOD: Method[TuneBlock, Tuning] = Method(TuneBlock, _run, summary, report, calibrated, command="tune")
