"""Design of experiments: what to record next."""

from __future__ import annotations

from pathlib import Path

from identification.design.design import Design, design
from identification.design.duration import shortest
from identification.design.report import report
from identification.design.schema import ExperimentDesignBlock
from identification.design.summary import summary
from identification.design.written import write_files
from identification.method import Calibrated, Method
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress


def _run(
    block: ExperimentDesignBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> Design:
    study = block.study(base)
    return design(study, progress) if study.sought is None else shortest(study, progress)


def _calibrated(result: Design, folder: Path) -> Calibrated:
    """Nothing: no FMU changes."""
    return Calibrated({})


METHOD: Method[ExperimentDesignBlock, Design] = Method(
    ExperimentDesignBlock, _run, summary, report, _calibrated, command="design", files=write_files
)
