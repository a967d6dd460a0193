"""A calibrated result judged on other recordings, and the folder that leaves."""

from __future__ import annotations

from pathlib import Path

from fmus.errors import IdentificationError
from identification.messages import Messages
from identification.output_error import validate as output_error_validation
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.validate import Validation
from identification.results import (
    STUDY,
    SUMMARY,
    ValidationSummary,
    result_file,
)
from identification.study import load_study
from identification.subspace import validate as subspace_validation
from identification.subspace.schema import SubspaceBlock
from identification.subspace.validate import LinearValidation
from orchestrator.fmi.isolation import Isolation
from orchestrator.fmi.said import LOG_FILE, kept
from orchestrator.progress import Progress, silent
from orchestrator.results import (
    aside,
    result_folder,
    write_json,
)
from orchestrator.yaml_file import naming


def validate(
    folder: str | Path, data: str | Path, progress: Progress = silent, isolation: Isolation | None = None
) -> Validation | LinearValidation:
    """Free runs of the calibrated FMUs in a folder that `CalibratedStudy.write` made, on recordings.

    Recordings that the fit used count apart from the others; FIT is `1 - |y - ŷ| / |y - mean y|`.

    Args:
        data: folder or file of recordings.
        isolation: how long a simulation may take, in processes of their own.

    Raises:
        InputError: the folder holds no result of FMUs or of a linear model, or the recordings do not fit its study.
        FmuError: the FMUs fail.
    """
    study = load_study(result_file(Path(folder), STUDY))
    if isinstance(study.block, SubspaceBlock) and study.block.traces.files is not None:
        with naming(study.file):
            return subspace_validation.validate(study.block, Path(folder), Path(data), isolation)
    if not isinstance(study.block, OutputErrorBlock) or study.block.traces.files is None:
        raise IdentificationError(study.file, "is no study of FMUs or of a linear model on recordings", "calibrate one")
    result, block = Path(folder), study.block
    calibrated = output_error_validation.calibrated_system(block, result)
    asked = block.study(calibrated, block.source(result))
    return output_error_validation.validate(asked, result, Path(data), progress, isolation)


def validate_result(
    folder: Path, data: Path, target: Path, progress: Progress, isolation: Isolation | None = None
) -> ValidationSummary:
    """Validate and write the folder of that; the summary comes back.

    Raises:
        InputError, FmuError: as in `validate`, or the target holds something else.
    """
    result_file(folder, STUDY)
    with aside(target, [folder, data]) as near:
        with kept(near / LOG_FILE):
            validation = validate(folder, data, progress, isolation)
        messages = Messages.of(near / LOG_FILE)
        summary, page = validation.summary, validation.report()
        summary["warnings"] += messages.warnings
        summary["messages"] = messages.summary
        with result_folder(target) as fresh:
            messages.write(page, fresh)
            page.write(fresh / "report.html")
            write_json(fresh / SUMMARY, summary)
    return summary
