"""Inverse dynamics: an axis' force as a linear function of its parameters, from recorded motions."""

from __future__ import annotations

from pathlib import Path

from identification.inverse_dynamics.calibration import InverseCalibration, calibrate
from identification.inverse_dynamics.report import report
from identification.inverse_dynamics.results import calibrated, summary
from identification.inverse_dynamics.schema import InverseDynamicsBlock
from identification.method import Method
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(
    block: InverseDynamicsBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> InverseCalibration:
    return calibrate(block.study(base), data, progress, isolation)


METHOD: Method[InverseDynamicsBlock, InverseCalibration] = Method(
    InverseDynamicsBlock, _run, summary, report, calibrated
)
