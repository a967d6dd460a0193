"""Tuning: a controller's values for plants and goals."""

from __future__ import annotations

from identification.method import Method, without_data
from identification.tuning.report.page import report
from identification.tuning.schema import TuneBlock
from identification.tuning.summary import calibrated, summary
from identification.tuning.tuning import Tuning, tune

METHOD: Method[TuneBlock, Tuning] = Method(TuneBlock, without_data(tune), summary, report, calibrated, command="tune")
