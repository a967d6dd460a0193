"""Output error: FMUs whose free runs are fitted to recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fmus.errors import within
from identification.estimation.listed import places, units
from identification.method import Method
from identification.output_error.calibration import Calibration, calibrate
from identification.output_error.candidates import choose
from identification.output_error.exported.free_run import write_free_run
from identification.output_error.report import report
from identification.output_error.results import calibrated, summary
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.study import OutputErrorStudy
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.scenario.parameter_sets import naming_places


def _run(
    block: OutputErrorBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> Calibration:
    with naming_places(places(block.document, base)):
        given, asked = units(block.document, base), block.complete(base)
        if not asked.candidates:
            return calibrate(_study(asked, base, given), data, progress, isolation)
        studies = dict[str, OutputErrorStudy]()
        for name in asked.candidates:
            with within(f"candidates.{name}"):
                studies[name] = _study(asked.candidate(name), base, given)
        return choose(studies, data, progress, isolation)


def _study(block: OutputErrorBlock, base: Path, given: Mapping[str, tuple[str, str]]) -> OutputErrorStudy:
    return replace(block.study(block.system(base), block.source(base)), given=given)


METHOD: Method[OutputErrorBlock, Calibration] = Method(
    OutputErrorBlock, _run, summary, report, calibrated, files=write_free_run
)
