"""The pendulum thesis' Steps 1-4: resonances under added masses."""

from __future__ import annotations

from pathlib import Path

from identification.method import Method
from identification.resonance.calibration import ResonanceCalibration, calibrate, calibrated, report, summary
from identification.resonance.schema import ResonanceBlock
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(
    block: ResonanceBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> ResonanceCalibration:
    return calibrate(block.study(base), data, progress, isolation)


METHOD: Method[ResonanceBlock, ResonanceCalibration] = Method(ResonanceBlock, _run, summary, report, calibrated)
