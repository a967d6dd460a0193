"""Recalibration near a motion: the pendulum thesis, Section 4."""

from __future__ import annotations

from pathlib import Path

from identification.method import Method
from identification.motion.calibration import MotionCalibration, calibrate
from identification.motion.report import report
from identification.motion.results import calibrated, summary
from identification.motion.schema import MotionBlock
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(
    block: MotionBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> MotionCalibration:
    return calibrate(block.study(base), data, progress, isolation)


METHOD: Method[MotionBlock, MotionCalibration] = Method(MotionBlock, _run, summary, report, calibrated)
