"""The folder a calibration leaves: calibrated FMUs, parameters.ssv, summary.json, report.html, and its study."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fmus.parameters import ssv
from fmus.parameters.write_back import write_back
from identification.output_error import report
from identification.output_error.calibration import Calibration, Judged
from identification.recordings.campaign import Recorded, recording_warnings
from identification.recordings.source import LayoutBlock
from identification.study import OutputErrorBlock, ResonanceBlock
from orchestrator.assembly.assembly import assemble
from orchestrator.fmi.interface import Value
from orchestrator.results import result_folder, versions, write_json

STUDY = "study.yaml"
SUMMARY = "summary.json"


def summary(calibration: Calibration) -> dict[str, Any]:
    """The calibration as plain values, as `summary.json` holds them; what is not determined is null."""
    study, found = calibration.study, calibration.estimate
    return {
        "title": study.title,
        "method": study.method,
        "parameters": {name: _parameter(calibration, name) for name in found.values},
        "fit": {
            "train": judged_summary(calibration.train),
            "validation": judged_summary(calibration.validation) if calibration.validation else None,
            "compared": {name: judged_summary(each) for name, each in calibration.compared.items()},
        },
        "uncertainty": {
            "method": found.uncertainty.method,
            "white_residuals": found.uncertainty.is_white,
            "singular_values": found.identifiability.singular_values.tolist(),
            "unseen": [combination.message for combination in found.identifiability.unseen],
            "weak": [combination.message for combination in found.identifiability.weak],
        },
        "search": {
            "converged": found.converged,
            "message": found.message,
            "iterations": found.iterations,
            "evaluations": found.tally.evaluations,
            "simulations": found.tally.simulations,
            "failures": found.tally.failures,
            "reasons": list(found.tally.reasons),
        },
        "data": data_summary(calibration.recorded, study.traces.hold_out),
        "versions": versions(),
        "warnings": [*found.warnings, *recording_warnings(calibration.recorded)],
    }


def judged_summary(judged: Judged) -> dict[str, Any]:
    """FIT of some windows: the median of all, of each trace and of each output; null where none moves."""
    by_trace = {name: finite(value) for name, value in judged.by_trace().items()}
    by_output = {name: finite(value) for name, value in judged.by_output().items()}
    return {"median": finite(judged.median), "windows": len(judged.cuts), "traces": by_trace, "outputs": by_output}


def data_summary(recorded: Iterable[Recorded], held_out: Iterable[str]) -> list[dict[str, Any]]:
    """File, hash and role of each trace, and the notes on its file where there are some."""
    kept = set(held_out)
    return [
        {
            "trace": each.trace.name,
            "file": each.source.name,
            "sha256": each.sha256,
            "stamps": each.stamps,
            "role": "held out" if each.trace.name in kept else "fit",
            **({"notes": list(each.notes)} if each.notes else {}),
        }
        for each in recorded
    ]


def write_calibration(calibration: Calibration, study_file: Path, target: Path) -> dict[str, Any]:
    """Write the result folder; the summary comes back.

    Raises:
        InputError: the target holds something else, or an FMU does not take a value.
    """
    document = summary(calibration)
    values = calibration.estimate.values
    with result_folder(target) as folder:
        write_system(calibration.study, study_file, folder, values, document)
        of_components = {name: value for name, value in values.items() if name not in calibration.study.delays}
        units = {name: unit for name, unit in calibration.units.items() if name in of_components and unit != "1"}
        (folder / "parameters.ssv").write_bytes(ssv.parameter_set("calibrated", of_components, units))
        report.report(calibration, document).write(folder / "report.html")
        write_json(folder / SUMMARY, document)
    return document


def write_system(
    study: OutputErrorBlock | ResonanceBlock,
    study_file: Path,
    folder: Path,
    values: Mapping[str, float],
    document: Mapping[str, Any],
) -> None:
    """The study's FMUs with its own and these values as defaults in `fmus/`, and the study beside them."""
    provenance = {key: document[key] for key in ("title", "method", "parameters", "data", "versions")}
    keep_study(study.traces.layout, study_file, folder)
    with tempfile.TemporaryDirectory(prefix="servotwin-") as built:
        assembled = assemble(study.system(study_file.parent), Path(built))
        for name, source in assembled.files.items():
            target = folder / "fmus" / f"{name}.fmu"
            own = component_values(name, {**study.values(), **values})
            write_back(source, own, target, provenance)
            if name not in assembled.built and not target.exists():
                shutil.copyfile(source, target)


def keep_study(layout: LayoutBlock, study_file: Path, folder: Path) -> None:
    """Copy the study into a result folder, and the database of its CAN logs beside it."""
    shutil.copyfile(study_file, folder / STUDY)
    database = layout.database_file(study_file.parent)
    if database is not None and database.is_file():
        shutil.copyfile(database, folder / database.name)


def component_values(component: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """variable -> value of one component."""
    prefix = f"{component}."
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def finite(value: float) -> float | None:
    """The value, None when it is infinite or NaN, as JSON has neither."""
    return value if math.isfinite(value) else None


def _parameter(calibration: Calibration, name: str) -> dict[str, Any]:
    found, study = calibration.estimate, calibration.study
    entry: dict[str, Any] = {
        "value": found.values[name],
        "std": finite(found.std[name]) if name in found.std else None,
        "ci95": [finite(end) for end in found.ci95[name]] if name in found.ci95 else None,
        "unit": calibration.units.get(name, "1"),
        "start": _start(study, name),
    }
    if name in study.truth:
        entry["truth"] = study.truth[name]
    return entry


def _start(study: OutputErrorBlock, name: str) -> Value | None:
    """Where the estimation of a parameter began; nothing for one that is tied to another."""
    block = study.parameters[name]
    if block.tied is not None:
        return None
    return block.start if block.start is not None else study.values()[name]
