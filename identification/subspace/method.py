"""Subspace identification: a linear model from records alone."""

from __future__ import annotations

from identification.method import Method
from identification.subspace.calibration import SubspaceCalibration, calibrate
from identification.subspace.results import calibrated, report, summary
from identification.subspace.schema import SubspaceBlock

METHOD: Method[SubspaceBlock, SubspaceCalibration] = Method(SubspaceBlock, calibrate, summary, report, calibrated)
