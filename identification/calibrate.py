"""The way in: a study calibrated by its method, and the folders that leaves."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from fmus.errors import ScenarioError
from fmus.parameters import srmd, ssv
from fmus.parameters.write_back import write_back
from identification.estimation.listed import complete
from identification.estimation.stopped import STOPPED
from identification.messages import Messages
from identification.method import Calibrated
from identification.output_error.choice.change import of_candidate
from identification.output_error.schema import OutputErrorBlock
from identification.results import (
    GROUPS,
    STUDY,
    SUMMARY,
    ParameterSummary,
    Summary,
)
from identification.study import Study, load_study
from orchestrator.assembly.schema import SystemBlock
from orchestrator.display.table import Cell, table
from orchestrator.documents.parts import INCLUDE
from orchestrator.fmi.isolation import Isolation
from orchestrator.fmi.said import LOG_FILE, kept
from orchestrator.formats import Layout
from orchestrator.processes.interrupts import whole
from orchestrator.progress import Progress, silent
from orchestrator.results import (
    CaseDocument,
    CheckDocument,
    FileDocument,
    aside,
    result_folder,
    write_json,
)
from orchestrator.yaml_file import joined, naming, text_of

if TYPE_CHECKING:
    from identification.experiments.claims import JudgedClaim
    from identification.experiments.summary import ExperimentsSummary

PROVENANCE = ("title", "method", "candidate", "parameters", "models", "data", "versions")
"""What of a summary travels inside the FMUs, where it says something."""


@dataclass(frozen=True, eq=False)
class CalibratedStudy:
    """A study and what came of it.

    Attributes:
        result: what the study's method gave, with all arrays: `Calibration` of output error, `SubspaceCalibration`, ...
        summary: the same in plain values, as `summary.json` holds it.
        messages: what the FMUs said meanwhile, where that was kept.
    """

    study: Study
    result: Any
    summary: Summary
    messages: Messages | None = None

    @property
    def parameters(self) -> dict[str, ParameterSummary]:
        """component.variable -> `value`, `std` and `ci95`, the ends of the 95 % interval, in `unit`."""
        return self.summary["parameters"]

    def write(self, folder: str | Path) -> Path:
        """Write FMUs with the estimates, parameters.ssv and .srmd, summary.json and report.html; the folder comes back.

        Raises:
            InputError: the folder holds something else, or an FMU does not take a value.
        """
        calibrated = self.study.method.calibrated
        known = {key: self.summary.get(key) for key in PROVENANCE}
        with tempfile.TemporaryDirectory(prefix="servotwin-") as built, result_folder(Path(folder)) as fresh:
            made = calibrated(self.result, Path(built))
            _write_fmus(made, fresh, {key: value for key, value in known.items() if value})
            if made.parameters:
                self._write_parameters(made, fresh)
            _write_groups(made, fresh)
            _keep(self.study, fresh, str(self.summary.get("candidate", "")))
            if self.study.method.files is not None:
                self.study.method.files(self.result, fresh, Path(folder))
            page = self.study.method.report(self.result)
            if self.messages is not None:
                self.messages.write(page, fresh)
            page.write(fresh / "report.html")
            write_json(fresh / SUMMARY, self.summary)
        return Path(folder)

    def _write_parameters(self, calibrated: Calibrated, folder: Path) -> None:
        """All parameters as a parameter set, and where they come from: data, method, intervals and versions."""
        written = ssv.parameter_set("calibrated", calibrated.parameters, calibrated.units)
        (folder / "parameters.ssv").write_bytes(written)
        summary = self.summary
        facts = {
            "calibration": {"title": summary["title"], "method": summary["method"]},
            "data": {
                f"{one['trace']} ({one['role']})": f"{one['file']}, SHA-256 {one['sha256']}" for one in summary["data"]
            },
            "interval": {name: _interval(one) for name, one in self.parameters.items() if one["ci95"] is not None},
            "version": summary["versions"],
        }
        about = srmd.meta_data(summary["title"], "parameters.ssv", written, facts)
        (folder / "parameters.srmd").write_bytes(about)

    def __repr__(self) -> str:
        names = ", ".join(self.parameters)
        return f"<CalibratedStudy '{self.summary['title']}' by {self.summary['method']}: {names or 'no parameters'}>"

    def _repr_html_(self) -> str:
        rows = [_row(name, parameter) for name, parameter in self.parameters.items()]
        headers = ("parameter", "estimate", "95 % from", "to", "unit")
        return table(headers, rows, caption=self.summary["title"])


def calibrate(
    study: Study | str | Path,
    data: str | Path | None = None,
    progress: Progress = silent,
    isolation: Isolation | None = None,
) -> CalibratedStudy:
    """Fit what a study leaves free, by the study's method.

    Args:
        study: a study file, or what `load_study` made of one.
        data: folder or file of recordings, over the study's own.
        isolation: how long a simulation may take; one that takes longer, or crashes, counts as failed.

    Raises:
        InputError: the study and the recordings do not fit together.
        FmuError: the FMUs fail.
        EstimationInterrupted, EstimationFailed: an interrupt or an FmuError came when something had been estimated; its
            `result` has that.
    """
    return _found(_loaded(study, "calibrate"), data, progress, isolation)


def tune(study: Study | str | Path, progress: Progress = silent) -> CalibratedStudy:
    """Find what a study of tuning asks for: values of a controller for several plants at once.

    Args:
        study: a study file, or what `load_study` made of one.

    Raises:
        InputError: the study's parts do not fit together.
        FmuError: the FMUs fail.
    """
    return _found(_loaded(study, "tune"), None, progress, None)


def design(study: Study | str | Path, progress: Progress = silent) -> CalibratedStudy:
    """Find the experiments after which a calibration's intervals are smallest.

    Args:
        study: a study file of `method: design`, or what `load_study` made of one.

    Raises:
        InputError: the study's parts do not fit together, or no experiment that is allowed shows all parameters.
        FmuError: the FMUs fail.
    """
    return _found(_loaded(study, "design"), None, progress, None)


def _loaded(study: Study | str | Path, command: str) -> Study:
    """The study, which is one for this command."""
    known = study if isinstance(study, Study) else load_study(study)
    if known.method.command != command:
        problem = f"is a study of the method '{known.block.method}'"
        raise ScenarioError(known.file, problem, f"give it to `servotwin {known.method.command}`")
    return known


def _found(
    known: Study,
    data: str | Path | None,
    progress: Progress,
    isolation: Isolation | None,
    log: Path | None = None,
) -> CalibratedStudy:
    """What a study's method gives.

    Args:
        log: file that takes all that FMUs say.
    """
    with naming(known.file):
        try:
            with kept(log):
                result = known.method.run(
                    known.block, known.base, None if data is None else Path(data), progress, isolation
                )
        except STOPPED as stop:
            stop.result = _summed_up(known, stop.result, log)
            raise
    return _summed_up(known, result, log)


def _summed_up(known: Study, result: Any, log: Path | None) -> CalibratedStudy:
    summary = known.method.summary(result)
    if log is None:
        return CalibratedStudy(known, result, summary)
    messages = Messages.of(log)
    summary["warnings"] = [*summary["warnings"], *messages.warnings]
    summary["messages"] = messages.summary
    return CalibratedStudy(known, result, summary, messages)


def calibrate_study(
    study_file: Path, data: Path | None, target: Path, progress: Progress, isolation: Isolation | None = None
) -> Summary:
    """Calibrate and write the result folder; the summary comes back.

    Raises:
        InputError: the study, its traces or the target do not fit.
        FmuError: the FMUs fail.
        EstimationInterrupted, EstimationFailed: as in `calibrate`; what had been estimated is written.
    """
    study = _loaded(study_file, "calibrate")
    with aside(target, [study_file, *([data] if data is not None else [])]) as near:
        try:
            found = _found(study, data, progress, isolation, near / LOG_FILE)
        except STOPPED as stop:
            with whole(), naming(study_file):
                stop.result.write(target)
            raise
        return _written(found, target, progress)


def study_without_data(
    command: Literal["tune", "design"],
    study_file: Path,
    target: Path,
    progress: Progress,
    isolation: Isolation | None = None,
) -> Summary:
    """Tune or design, and write the result folder; the summary comes back.

    Args:
        command: of the command line, that the study has to be for.
        isolation: of FMUs given as files, in simulated loops and on rigs; a run that crashes or hangs has failed.

    Raises:
        InputError: the study or the target do not fit, or no experiment shows all parameters.
        FmuError: the FMUs fail.
    """
    study = _loaded(study_file, command)
    with aside(target, [study_file]) as near:
        return _written(_found(study, None, progress, isolation, near / LOG_FILE), target, progress)


def _written(found: CalibratedStudy, target: Path, progress: Progress) -> Summary:
    progress(1.0, "writing")
    with naming(found.study.file):
        found.write(target)
    return found.summary


def _write_fmus(calibrated: Calibrated, folder: Path, provenance: Mapping[str, Any]) -> None:
    """The FMUs with their values, or those that cannot hold them with a parameter set beside."""
    for name, fmu in calibrated.fmus.items():
        target = folder / "fmus" / f"{name}.fmu"
        if target not in write_back(fmu.source, fmu.values, target, provenance, fmu.step):
            shutil.copyfile(fmu.source, target)


def _write_groups(calibrated: Calibrated, folder: Path) -> None:
    """A parameter set for each group of recordings, with what it has of its own."""
    for group, values in calibrated.groups.items():
        (folder / GROUPS).mkdir(exist_ok=True)
        (folder / GROUPS / f"{group.replace('/', '_')}.ssv").write_bytes(
            ssv.parameter_set(group, values, calibrated.units)
        )


def _interval(parameter: ParameterSummary) -> str:
    """The 95 % interval in words."""
    ends = ["unknown" if end is None else repr(end) for end in parameter["ci95"] or ()]
    return f"95 % from {' to '.join(ends)} {parameter['unit']}".rstrip()


def _keep(study: Study, folder: Path, candidate: str) -> None:
    """Copy the study, joined with what it includes and lists, into a result folder, and the databases of its CAN logs;
    of a study with candidates the one that was chosen."""
    block = study.block
    lists = isinstance(block, OutputErrorBlock) and bool(block.estimate or block.parameter_sets)
    if candidate or lists or (isinstance(block, SystemBlock) and block.include):
        document, _ = joined(study.file, type(block))
        document.pop(INCLUDE, None)
        document = complete(document, study.base) if lists else document
        (folder / STUDY).write_bytes(text_of(of_candidate(document, candidate) if candidate else document))
    else:
        shutil.copyfile(study.file, folder / STUDY)
    for database in study.block.databases(study.base):
        if database.is_file():
            shutil.copyfile(database, folder / database.name)


def judge_claims(study_file: Path, target: Path) -> FileDocument:
    """How the claims of a study of experiments come out, a case each, for the regression suite.

    Raises:
        InputError, FmuError: as in `calibrate_study`.
    """
    if load_study(study_file).block.method != "experiments":
        raise ScenarioError(study_file, "states claims but is no study of experiments", "set `method: experiments`")
    found = cast("ExperimentsSummary", calibrate_study(study_file, None, target, silent))
    cases = [_case(claim) for claim in found["claims"]]
    return {"title": found["title"], "passed": found["as_stated"], "out": str(target), "cases": cases}


def _case(claim: JudgedClaim) -> CaseDocument:
    checks: list[CheckDocument] = [
        {"text": comparison.text, "held": comparison.held, "found": comparison.text} for comparison in claim.comparisons
    ]
    problem = None if claim.as_stated else f"{claim.outcome}, where the study states '{claim.stated}'"
    return {"name": claim.statement, "passed": claim.as_stated, "error": problem, "checks": checks}


def layout_of(study_file: Path) -> Layout:
    """How a study reads its recordings."""
    study = load_study(study_file)
    layout: Layout = study.block.layout(study.base)
    return layout


def _row(name: str, parameter: ParameterSummary) -> tuple[Cell, ...]:
    low, high = parameter["ci95"] or (None, None)
    return name, parameter["value"], low, high, parameter["unit"]
