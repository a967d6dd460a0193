"""A linear model that a calibration wrote, judged on other recordings by its free runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmus.errors import IdentificationError
from identification.fits import FitSummary, fit_summary, told
from identification.linear.fmu import model_in, zero_in
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData, check_rate
from identification.recordings.campaign import StudyTrace, load_campaign
from identification.recordings.units import in_common_units
from identification.result_sections import verdict_callout
from identification.results import ValidationSummary, by_use, read_summary, validation_summary
from identification.subspace.calibration import pieces, records
from identification.subspace.free_runs import free_runs, samples_for
from identification.subspace.schema import SubspaceBlock
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.isolation import Isolation
from orchestrator.report import Report, figures
from orchestrator.trace import FloatArray

_SHOWN = 8  # records with their free runs


@dataclass(frozen=True, eq=False)
class LinearValidation:
    """Free runs of a linear model.

    Attributes:
        sides: "unseen" and "fitted" -> FIT of the recordings that its fit did not use, and of those that it did.
        runs: a record and its free run (K, p), for the report.
    """

    study: SubspaceBlock
    recorded: tuple[StudyTrace, ...]
    sides: Mapping[str, FitSummary]
    runs: tuple[tuple[InputOutputData, FloatArray], ...]
    unseen: tuple[str, ...]

    @property
    def summary(self) -> ValidationSummary:
        """The validation as `summary.json` holds it."""
        return validation_summary(self.study, self.sides, self.recorded, self.unseen)

    def report(self) -> Report:
        """FIT and free runs."""
        page = Report(f"Validation: {self.study.title}", self.study.description)
        section, known = page.section("Result"), self.summary
        verdict_callout(section, known["verdict"])
        rows = [[name, fit["median"], told(fit.get("worst"))] for name, fit in self.sides.items()]
        section.table(["recordings", "median FIT", "worst"], rows)
        section = page.section("Free runs")
        for record, run in self.runs[:_SHOWN]:
            measured, free = map(record.free_run, (record.y, run))
            section.figure(figures.overlay(measured, [("the model", free)]), record.name)
        return page


def validate(
    study: SubspaceBlock, folder: Path, data: Path | None = None, isolation: Isolation | None = None
) -> LinearValidation:
    """Free runs of the model in a result folder; recordings that the fit used (by their hash) count apart.

    Raises:
        InputError: the folder holds no result of the study, or the recordings do not fit it.
    """
    earlier, file = read_summary(folder), folder / "fmus" / f"{study.name}.fmu"
    interface = FmuDescription(file).interface
    model, zero = model_in(interface, str(file)), zero_in(interface, str(file))
    recorded = load_campaign(study.source(folder), data, isolation=isolation, foreign=True)
    recorded = in_common_units(recorded, [*study.inputs, *study.outputs])
    groups = by_use(recorded, earlier)
    sides, runs = dict[str, FitSummary](), list[tuple[InputOutputData, FloatArray]]()
    for name, traces in groups.items():
        given = records(study, traces)
        check_rate(list(given.values()), model.step, "the model")
        cut = pieces(study, given, zero)
        if not cut:
            continue
        free, fits = free_runs(model, [piece for _, piece in cut], _samples(study, model, name))
        runs += zip([piece for _, piece in cut], free, strict=True)
        sides[name] = fit_summary(fits, [piece.name for _, piece in cut], [trace for trace, _ in cut], study.outputs)
    if not sides:
        raise IdentificationError(str(data or folder), "holds nothing to judge a model on", "give other recordings")
    unseen = tuple(trace.trace.name for trace in groups["unseen"])
    return LinearValidation(study, tuple(recorded), sides, tuple(runs), unseen)


def _samples(study: SubspaceBlock, model: LinearModel, side: str) -> float | None:
    """From which the state at the beginning of a record is estimated; None starts at rest."""
    if not study.initial_states:
        return None
    return math.inf if side == "fitted" else samples_for(model, study.start)
