"""A calibrated result judged on other recordings: free runs of its FMUs, set to nothing but what recordings tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from fmus.errors import InputError
from fmus.packaging import archive
from fmus.parameters.write_back import description_of, is_ours
from identification.estimation.groups import MARK, as_found
from identification.fits import told
from identification.output_error.calibration import Judged, isolated, judge
from identification.output_error.chosen_windows import chosen_length, picked_windows
from identification.output_error.report import fits, overlays
from identification.output_error.results import OutputErrorSummary, WindowsSummary
from identification.output_error.study import OutputErrorStudy
from identification.output_error.study_checks import ports_of
from identification.recordings.campaign import StudyTrace, load_campaign
from identification.result_sections import verdict_callout
from identification.results import (
    STUDY,
    SUMMARY,
    Summary,
    ValidationSummary,
    by_use,
    read_summary,
    validation_summary,
)
from identification.signals.excitation import Length
from orchestrator.assembly.assembly import OpenSystem, SystemSpec, assemble
from orchestrator.assembly.schema import SystemBlock
from orchestrator.assembly.whole_arrays import elements
from orchestrator.crossing import Crossing, noted
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.report import Report, figures
from orchestrator.scenario.parameter_sets import values_in
from orchestrator.yaml_file import naming


@dataclass(frozen=True, eq=False)
class Validation:
    """Free runs of a result's FMUs.

    Attributes:
        judged: "unseen" and "fitted" -> free runs on recordings that the fit did not use, and on those that it did.
    """

    study: OutputErrorStudy
    recorded: tuple[StudyTrace, ...]
    judged: Mapping[str, Judged]
    unseen: tuple[str, ...]

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """Signals that were converted, or taken as they are although their units differ."""
        return noted(crossing for judged in self.judged.values() for crossing in judged.crossings)

    @property
    def summary(self) -> ValidationSummary:
        """The validation as `summary.json` holds it."""
        sides = {name: judged.summary for name, judged in self.judged.items()}
        return validation_summary(self.study, sides, self.recorded, self.unseen, self.crossings)

    def report(self) -> Report:
        """Whether the target is met, free runs, and how FIT is spread."""
        page = Report(f"Validation: {self.study.title}", self.study.description)
        section, judged, target = page.section("Result"), self.judged, self.study.at_least
        section.highlights(
            [
                (
                    f"median FIT, {name}",
                    f"{group.median:.3f}",
                    f"{len(group.windows)} windows, worst {told(group.summary.get('worst'))}",
                )
                for name, group in judged.items()
            ]
        )
        verdict_callout(section, self.summary["verdict"])
        fits(section, judged, target)
        for name, group in judged.items():
            overlays(page.section(f"Free runs, {name}"), {}, group, {})
        spread = np.concatenate([group.fit.ravel() for group in judged.values()])
        known = spread[np.isfinite(spread)]
        if len(known):
            section.figure(figures.distribution(known, "FIT"), "FIT of all windows")
        return page


def validate(
    study: OutputErrorStudy,
    folder: Path,
    data: Path | None = None,
    progress: Progress = silent,
    isolation: Isolation | None = None,
) -> Validation:
    """Free runs of the calibrated FMUs in a result folder; recordings that the fit used (by their hash) count apart.

    Args:
        study: the result's, of its `calibrated_system`.

    Raises:
        InputError: the folder holds no result of the study, or the recordings do not fit it.
        FmuError: the FMUs fail.
    """
    study, earlier = isolated(study, isolation), read_summary(folder)
    study, values = _with_groups(study, earlier)
    values |= _found_delays(study, earlier, folder)
    recorded = load_campaign(study.traces, data, isolation=study.options.isolation, foreign=True)
    groups = by_use(recorded, earlier)
    assembled = assemble(study.system, folder, sorted(study.run.inputs))
    with OpenSystem(assembled) as opened:
        ports = ports_of(study, opened.system)
    judged = {}
    for number, (name, traces) in enumerate(groups.items()):
        progress(number / 2, f"{len(traces)} {name} traces")
        if traces:
            with naming(folder / STUDY):
                windows, _ = picked_windows(study.run, traces, study.validation, _length(study, earlier, traces), ports)
                judged[name] = judge(study, assembled, windows, values)
    return Validation(study, tuple(recorded), judged, tuple(trace.trace.name for trace in groups["unseen"]))


def _found_delays(study: OutputErrorStudy, earlier: Summary, folder: Path) -> dict[str, float]:
    """The delays that the calibration found; they are no parameters of an FMU."""
    grouped = {one.variable for one in study.grouped}
    delays = [name for name in study.delays if name not in grouped]
    for name in delays:
        if name not in earlier["parameters"]:
            raise InputError(folder / SUMMARY, f"does not tell the delays of its study ({name})", "calibrate again")
    return {name: earlier["parameters"][name]["value"] for name in delays}


def _length(study: OutputErrorStudy, earlier: Summary, traces: Sequence[StudyTrace]) -> Length | None:
    """How long windows are that recordings choose: as in the calibration."""
    known: WindowsSummary | None = cast("OutputErrorSummary", earlier).get("windows")
    return Length(known["steps"] * study.run.step, known["period"]) if known else chosen_length(study, traces)


def _with_groups(study: OutputErrorStudy, earlier: Summary) -> tuple[OutputErrorStudy, dict[str, float]]:
    """The study with parameters told apart as the calibration did, and the values that it found for each group."""
    known = {name: entry for name, entry in earlier["parameters"].items() if "of" in entry}
    values = {name: entry["value"] for name, entry in known.items()}
    groups = dict[str, list[str]]()
    for name, entry in known.items():
        groups.setdefault(entry["of"], []).append(name.removeprefix(f"{entry['of']}{MARK}"))
    ties = {tie.name: tie.other for tie in study.parameters.ties}
    parts = {part.name: part.trace for part in study.traces.parts}
    grouped = tuple(
        as_found(name, study.by[ties.get(name, name)], names, parts)
        for name, names in groups.items()
        if ties.get(name, name) in study.by
    )
    return replace(study, grouped=grouped), values


def calibrated_system(block: SystemBlock, folder: Path) -> SystemSpec:
    """A study's system of the calibrated FMUs, with nothing set but in FMUs that cannot hold values of their own.

    Raises:
        FmuFileError: an FMU is not there, or none.
    """
    files = {name: folder / "fmus" / f"{name}.fmu" for name in block.components}
    components = {name: one.made_of(files[name], _beside(files[name])) for name, one in block.components.items()}
    return SystemSpec(components, block.links())


def _beside(file: Path) -> dict[str, Value]:
    """Values with their units from the parameter set beside an FMU that is not ours; of one of ours nothing is set."""
    contents = archive.read(file)
    if is_ours(contents, description_of(file, contents)):
        return {}
    return elements(values_in(file.with_suffix(".ssv")).values)
