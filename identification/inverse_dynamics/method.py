"""Inverse dynamics: an axis' force as a linear function of its parameters, from recorded motions."""

from __future__ import annotations

from identification.inverse_dynamics.calibration import InverseCalibration, calibrate
from identification.inverse_dynamics.report import report
from identification.inverse_dynamics.results import calibrated, summary
from identification.inverse_dynamics.schema import InverseDynamicsBlock
from identification.method import Method, of_study

METHOD: Method[InverseDynamicsBlock, InverseCalibration] = Method(
    InverseDynamicsBlock, of_study(calibrate), summary, report, calibrated
)
