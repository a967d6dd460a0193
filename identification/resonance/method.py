"""The pendulum thesis' Steps 1-4: resonances under added masses."""

from __future__ import annotations

from identification.method import Method, of_study
from identification.resonance.calibration import ResonanceCalibration, calibrate, calibrated, report, summary
from identification.resonance.schema import ResonanceBlock

METHOD: Method[ResonanceBlock, ResonanceCalibration] = Method(
    ResonanceBlock, of_study(calibrate), summary, report, calibrated
)
