"""Recalibration near a motion: the pendulum thesis, Section 4."""

from __future__ import annotations

from identification.method import Method, of_study
from identification.motion.calibration import MotionCalibration, calibrate
from identification.motion.report import report
from identification.motion.results import calibrated, summary
from identification.motion.schema import MotionBlock

METHOD: Method[MotionBlock, MotionCalibration] = Method(MotionBlock, of_study(calibrate), summary, report, calibrated)
