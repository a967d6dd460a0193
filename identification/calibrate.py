"""What the command line asks of identification: calibrate a study, and judge a result on other traces."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import IdentificationError, InputError, ScenarioError
from fmus.packaging import archive
from fmus.parameters import ssv
from fmus.parameters.write_back import description_of, is_ours
from identification.experiments import experiments, report
from identification.experiments.schema import ExperimentsBlock
from identification.output_error import calibration, results
from identification.output_error.calibration import Judged
from identification.output_error.estimator import Progress
from identification.output_error.report import fits, overlays
from identification.output_error.results import STUDY, SUMMARY, data_summary, judged_summary
from identification.recordings.campaign import Recorded, load_campaign, recording_warnings
from identification.resonance import calibration as resonance_calibration
from identification.study import OutputErrorBlock, ResonanceBlock, SubspaceBlock, load_study
from identification.subspace import calibration as subspace_calibration
from identification.subspace import results as subspace_results
from orchestrator.assembly.assembly import SystemSpec, assemble
from orchestrator.fmi.interface import Value
from orchestrator.formats import Layout
from orchestrator.report import Report, figures
from orchestrator.results import (
    CaseDocument,
    CheckDocument,
    FileDocument,
    check_target,
    result_folder,
    versions,
    write_json,
)
from orchestrator.yaml_file import naming

Move = Callable[[float, str], None]


def calibrate_study(study_file: Path, data: Path | None, target: Path, move: Move) -> dict[str, Any]:
    """Calibrate by the study's method and write the result folder; the summary comes back.

    Raises:
        InputError: the study, its traces or the target do not fit.
        FmuError: the FMUs fail.
    """
    study = load_study(study_file)
    check_target(target)
    with naming(study_file):
        if isinstance(study, ResonanceBlock):
            result = resonance_calibration.calibrate(
                study, study_file.parent, data, lambda fraction, doing: move(fraction, "simulating the campaign")
            )
            return resonance_calibration.write_calibration(result, study_file, target)
        if isinstance(study, SubspaceBlock):
            found = subspace_calibration.calibrate(study, study_file.parent, data, move)
            return subspace_results.write_calibration(found, study_file, target)
        if isinstance(study, ExperimentsBlock):
            campaign = experiments.run(study, study_file.parent, data, move)
            return report.write_calibration(campaign, study_file, target)
        done = calibration.calibrate(study, study_file.parent, data, _listener(study, move))
        move(1.0, "writing")
        return results.write_calibration(done, study_file, target)


def judge_claims(study_file: Path, target: Path) -> FileDocument:
    """How the claims of a study of experiments come out, a case each, for the regression suite.

    Raises:
        InputError, FmuError: as in `calibrate_study`.
    """
    if not isinstance(load_study(study_file), ExperimentsBlock):
        raise ScenarioError(study_file, "states claims but is no study of experiments", "set `method: experiments`")
    found = calibrate_study(study_file, None, target, lambda fraction, doing: None)
    cases = [_case(claim) for claim in found["claims"]]
    return {"title": found["title"], "passed": found["as_stated"], "out": str(target), "cases": cases}


def _case(claim: dict[str, Any]) -> CaseDocument:
    checks: list[CheckDocument] = [
        {"text": comparison["text"], "held": comparison["held"], "found": comparison["text"]}
        for comparison in claim["comparisons"]
    ]
    stated = claim["outcome"] == claim["stated"]
    problem = None if stated else f"{claim['outcome']}, where the study states '{claim['stated']}'"
    return {"name": claim["statement"], "passed": stated, "error": problem, "checks": checks}


def validate_result(folder: Path, data: Path, target: Path, move: Move) -> dict[str, Any]:
    """Free runs of a result's calibrated FMUs on recordings, with nothing set but what the recordings tell.

    Recordings that the fit used (by their hash) count apart from the others.

    Raises:
        InputError: the folder holds no output-error result, or the recordings do not fit its study.
    """
    study = load_study(_result_file(folder, STUDY))
    used = _used_hashes(folder)
    if not isinstance(study, OutputErrorBlock) or study.traces.files is None:
        raise IdentificationError(folder / STUDY, "is no output-error study of recordings", "calibrate one")
    check_target(target)
    recorded = load_campaign(study.traces, folder, data, signals=study.signals)
    delays = _found_delays(study, folder)
    groups = {
        "unseen": [each for each in recorded if each.sha256 not in used],
        "fitted": [each for each in recorded if each.sha256 in used],
    }
    judged = {}
    for number, (name, traces) in enumerate(groups.items()):
        move(number / 2, f"{len(traces)} {name} traces")
        if traces:
            with naming(folder / STUDY):
                judged[name] = _judge(study, folder, traces, delays)
    document = _verdict(study, judged, recorded, [each.trace.name for each in groups["unseen"]])
    with result_folder(target) as fresh:
        _report(study, judged, document).write(fresh / "report.html")
        write_json(fresh / SUMMARY, document)
    return document


def layout_of(study_file: Path) -> Layout:
    """How a study reads its recordings."""
    study = load_study(study_file)
    if isinstance(study, ExperimentsBlock):
        return Layout()
    return study.traces.layout.layout(study_file.parent, study.signals)


def _listener(study: OutputErrorBlock, move: Move) -> Callable[[Progress], None]:
    limit = study.options.max_evaluations

    def listen(at: Progress) -> None:
        fraction = {"fit": 0.1 + 0.7 * min(at.iteration / limit, 1), "uncertainty": 0.8}.get(at.stage, 0.05)
        move(fraction, f"{at.stage} {at.iteration}, cost {at.cost:.4g}, {at.simulations} simulations")

    return listen


def _result_file(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        raise InputError(folder, f"holds no {name}", "give a folder that `servotwin calibrate` wrote")
    return folder / name


def _used_hashes(folder: Path) -> set[str]:
    file = _result_file(folder, SUMMARY)
    try:
        entries = json.loads(file.read_text())["data"]
        return {entry["sha256"] for entry in entries if entry["role"] == "fit"}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(file, f"is not a calibration's summary ({error!r})", "calibrate again") from error


def _found_delays(study: OutputErrorBlock, folder: Path) -> dict[str, float]:
    """The delays that the calibration found; they are no parameters of an FMU."""
    file = _result_file(folder, SUMMARY)
    try:
        entries = json.loads(file.read_text())["parameters"]
        return {name: float(entries[name]["value"]) for name in study.delays}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(file, f"does not tell the delays of its study ({error!r})", "calibrate again") from error


def _judge(study: OutputErrorBlock, folder: Path, traces: list[Recorded], delays: Mapping[str, float]) -> Judged:
    files = {name: folder / "fmus" / f"{name}.fmu" for name in study.components}
    components = {name: block.made_of(files[name], _beside(files[name])) for name, block in study.components.items()}
    assembled = assemble(SystemSpec(components, study.links()), folder, sorted(study.inputs))
    windows = study.validation or study.windows
    return calibration.judge(study, assembled, traces, windows, delays)


def _beside(file: Path) -> dict[str, Value]:
    """Values from the parameter set beside an FMU that is not ours; nothing is set in one of ours."""
    contents = archive.read(file)
    if is_ours(contents, description_of(file, contents)):
        return {}
    return {name: str(v) if isinstance(v, str) else v for name, v in ssv.read_values(file.with_suffix(".ssv")).items()}


def _verdict(
    study: OutputErrorBlock, judged: dict[str, Judged], recorded: list[Recorded], unseen: list[str]
) -> dict[str, Any]:
    target = study.validation.at_least if study.validation else None
    counted = judged.get("unseen") or judged["fitted"]
    warnings = [] if "unseen" in judged else ["every recording was used in the fit; this judges nothing new"]
    return {
        "title": study.title,
        "fit": {name: judged_summary(each) for name, each in judged.items()},
        "at_least": target,
        "held": target is None or counted.median >= target,
        "data": data_summary(recorded, unseen),
        "versions": versions(),
        "warnings": warnings + recording_warnings(recorded),
    }


def _report(study: OutputErrorBlock, judged: dict[str, Judged], document: dict[str, Any]) -> Report:
    page = Report(f"Validation: {study.title}", study.description)
    section = page.section("Result")
    section.highlights(
        [(f"median FIT, {name}", f"{each.median:.3f}", f"{len(each.cuts)} windows") for name, each in judged.items()]
    )
    target = document["at_least"]
    section.callout(
        "ok" if document["held"] else "error", f"Target: {target}" if target else "The study sets no target."
    )
    fits(section, judged, target)
    for name, each in judged.items():
        overlays(page.section(f"Free runs, {name}"), study, {}, each, {})
    spread = np.concatenate([each.fit.ravel() for each in judged.values()])
    known = spread[np.isfinite(spread)]
    if len(known):
        section.figure(figures.distribution(known, "FIT"), "FIT of all windows")
    return page
