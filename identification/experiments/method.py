"""The manipulator thesis' campaign: many data sets of one rig, held against claims."""

from __future__ import annotations

from identification.experiments.experiments import Experiments, run
from identification.experiments.report import report
from identification.experiments.schema import ExperimentsBlock
from identification.experiments.summary import calibrated, summary
from identification.method import Method

METHOD: Method[ExperimentsBlock, Experiments] = Method(ExperimentsBlock, run, summary, report, calibrated)
