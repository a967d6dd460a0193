"""Output error: FMUs whose free runs are fitted to recordings."""

from __future__ import annotations

from pathlib import Path

from identification.method import Method
from identification.output_error.calibration import Calibration, calibrate
from identification.output_error.report import report
from identification.output_error.results import calibrated, summary
from identification.output_error.schema import OutputErrorBlock
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(
    block: OutputErrorBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> Calibration:
    return calibrate(block.study(block.system(base), block.source(base)), data, progress, isolation)


METHOD: Method[OutputErrorBlock, Calibration] = Method(OutputErrorBlock, _run, summary, report, calibrated)
