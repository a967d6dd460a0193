"""Output error: FMUs whose free runs are fitted to recordings."""

from __future__ import annotations

from identification.method import Method
from identification.output_error.calibration import Calibration, calibrate
from identification.output_error.report import report
from identification.output_error.results import calibrated, summary
from identification.output_error.schema import OutputErrorBlock

METHOD: Method[OutputErrorBlock, Calibration] = Method(OutputErrorBlock, calibrate, summary, report, calibrated)
