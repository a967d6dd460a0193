"""The way in: a study calibrated by its method, a result judged on other traces, and the folders they leave."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from fmus.errors import IdentificationError, ScenarioError
from fmus.parameters import ssv
from fmus.parameters.write_back import write_back
from identification.method import Calibrated
from identification.output_error import validate
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.validate import ValidationSummary
from identification.results import STUDY, SUMMARY, ClaimsSummary, ClaimSummary, Summary, result_file
from identification.study import Study, load_study
from orchestrator.formats import Layout
from orchestrator.progress import Progress, silent
from orchestrator.results import CaseDocument, CheckDocument, FileDocument, check_target, result_folder, write_json
from orchestrator.yaml_file import naming

PROVENANCE = ("title", "method", "parameters", "models", "data", "versions")
"""What of a summary travels inside the FMUs, where it says something."""


def calibrate_study(study_file: Path, data: Path | None, target: Path, progress: Progress) -> Summary:
    """Calibrate by the study's method and write the result folder; the summary comes back.

    Raises:
        InputError: the study, its traces or the target do not fit.
        FmuError: the FMUs fail.
    """
    study = load_study(study_file)
    check_target(target)
    with naming(study_file):
        result = study.method.run(study.block, study.base, data, progress)
        progress(1.0, "writing")
        return write_result(study, result, target)


def write_result(study: Study, result: Any, target: Path) -> Summary:
    """Write the folder of what a study's method gave: FMUs, parameters.ssv, summary.json, report.html and the study.

    Raises:
        InputError: the target holds something else, or an FMU does not take a value.
    """
    summary = study.method.summary(result)
    known = {key: summary.get(key) for key in PROVENANCE}
    with tempfile.TemporaryDirectory(prefix="servotwin-") as built, result_folder(target) as folder:
        calibrated = study.method.calibrated(result, Path(built))
        _write_fmus(calibrated, folder, {key: value for key, value in known.items() if value})
        _keep(study, folder)
        study.method.report(result).write(folder / "report.html")
        write_json(folder / SUMMARY, summary)
    return summary


def _write_fmus(calibrated: Calibrated, folder: Path, provenance: Mapping[str, Any]) -> None:
    """The FMUs with their values, or those that cannot hold them with a parameter set beside; and all parameters."""
    for name, fmu in calibrated.fmus.items():
        target = folder / "fmus" / f"{name}.fmu"
        if target not in write_back(fmu.source, fmu.values, target, provenance):
            shutil.copyfile(fmu.source, target)
    if calibrated.parameters:
        parameters = ssv.parameter_set("calibrated", calibrated.parameters, calibrated.units)
        (folder / "parameters.ssv").write_bytes(parameters)


def _keep(study: Study, folder: Path) -> None:
    """Copy the study into a result folder, and the database of its CAN logs beside it."""
    shutil.copyfile(study.file, folder / STUDY)
    database = study.block.database(study.base)
    if database is not None and database.is_file():
        shutil.copyfile(database, folder / database.name)


def validate_result(folder: Path, data: Path, target: Path, progress: Progress) -> ValidationSummary:
    """Free runs of a result's calibrated FMUs on recordings, with nothing set but what the recordings tell.

    Recordings that the fit used (by their hash) count apart from the others.

    Raises:
        InputError: the folder holds no output-error result, or the recordings do not fit its study.
    """
    study = load_study(result_file(folder, STUDY))
    result_file(folder, SUMMARY)
    if not isinstance(study.block, OutputErrorBlock) or study.block.traces.files is None:
        raise IdentificationError(study.file, "is no output-error study of recordings", "calibrate one")
    check_target(target)
    plain = study.block.study(validate.calibrated_system(study.block, folder), study.block.source(folder))
    validation = validate.validate(plain, folder, data, progress)
    summary = validate.summary(validation)
    with result_folder(target) as fresh:
        validate.report(validation).write(fresh / "report.html")
        write_json(fresh / SUMMARY, summary)
    return summary


def judge_claims(study_file: Path, target: Path) -> FileDocument:
    """How the claims of a study of experiments come out, a case each, for the regression suite.

    Raises:
        InputError, FmuError: as in `calibrate_study`.
    """
    if load_study(study_file).block.method != "experiments":
        raise ScenarioError(study_file, "states claims but is no study of experiments", "set `method: experiments`")
    found = cast(ClaimsSummary, calibrate_study(study_file, None, target, silent))
    cases = [_case(claim) for claim in found["claims"]]
    return {"title": found["title"], "passed": found["as_stated"], "out": str(target), "cases": cases}


def _case(claim: ClaimSummary) -> CaseDocument:
    checks: list[CheckDocument] = [
        {"text": comparison["text"], "held": comparison["held"], "found": comparison["text"]}
        for comparison in claim["comparisons"]
    ]
    stated = claim["outcome"] == claim["stated"]
    problem = None if stated else f"{claim['outcome']}, where the study states '{claim['stated']}'"
    return {"name": claim["statement"], "passed": stated, "error": problem, "checks": checks}


def layout_of(study_file: Path) -> Layout:
    """How a study reads its recordings."""
    study = load_study(study_file)
    layout: Layout = study.block.layout(study.base)
    return layout
