"""Subspace identification: a linear model from records alone."""

from __future__ import annotations

from identification.method import Method
from identification.subspace.calibration import SubspaceCalibration, calibrate
from identification.subspace.report import report
from identification.subspace.schema import SubspaceBlock
from identification.subspace.summary import calibrated, summary

METHOD: Method[SubspaceBlock, SubspaceCalibration] = Method(SubspaceBlock, calibrate, summary, report, calibrated)
