"""What a campaign of experiments leaves beside its report: numbers and models in summary.json, models as FMUs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from typing_extensions import TypedDict

from identification.experiments.claims import JudgedClaim, figures, unexpected, verdicts
from identification.experiments.experiments import Experiments
from identification.experiments.reduction import ReductionExample
from identification.experiments.schema import ControlLoop
from identification.experiments.set_result import SetResult
from identification.experiments.tables import ThesisTable, model_name, reduced_name, tables
from identification.linear.fmu import linear_fmu
from identification.linear.model import LinearModel
from identification.linear.summary import ModelSummary, ModeSummary, mode_summaries, model_summary
from identification.method import Calibrated
from identification.recordings.units import unit_documents
from identification.results import Summary, data_summary, finite
from orchestrator.results import versions
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class AttemptSummary:
    """How a model of one order did: delta of each output in data matching and in set-point following, None for an
    unstable loop."""

    stable: bool
    dmv: FloatArray
    sfv: FloatArray | None


class SetSummary(TypedDict):
    """A data set: its entry in the study, and what came of it; `stop_time` [s], `by_order` by order."""

    experiment: ControlLoop
    excitation: str
    volts: float
    rate: float
    payload: float
    samples: int
    compensation: float
    compensation_removed: bool
    stable_orders: list[int]
    order: int
    stop_time: float
    frequency_distances: list[float | None]
    by_order: dict[str, AttemptSummary]
    model: str


@dataclass(frozen=True)
class ModeRank:
    """A mode by its label, and its ranks."""

    mode: str
    mrm: int
    msv: int


@dataclass(frozen=True, eq=False)
class StageSummary:
    """A reduced or updated model: which modes it keeps, all when there are none, and its errors as in an attempt."""

    kept: tuple[str, ...]
    order: int
    dmv: FloatArray
    sfv: FloatArray | None


class ExampleSummary(TypedDict):
    """A model that was reduced and updated."""

    data: str
    compensation_removed: bool
    ranking: list[ModeRank]
    stages: dict[str, StageSummary]


class FinalModelSummary(ModelSummary):
    """A model that is written, with its modes."""

    modes: list[ModeSummary]


@dataclass(frozen=True)
class PayloadMode:
    """A mode of the physical model: payload [kg], frequency [Hz], damping ratio."""

    payload: float
    frequency: float
    damping: float


class ExperimentsSummary(Summary):
    """The summary of a campaign of experiments; `figures` are those that claims speak of."""

    as_stated: bool
    claims: list[JudgedClaim]
    sets: dict[str, SetSummary]
    examples: dict[str, ExampleSummary]
    linear_models: dict[str, FinalModelSummary]
    figures: dict[str, float | None]
    compared: dict[str, float | None] | None
    physical_modes: list[PayloadMode]
    tables: dict[str, ThesisTable]


def summary(experiments: Experiments) -> ExperimentsSummary:
    """The study as `summary.json` holds it."""
    study, claims, found = experiments.study, verdicts(experiments), tables(experiments)
    others = unexpected(claims)
    return {
        "title": study.title,
        "method": study.method,
        "parameters": {},
        "fit": {},
        "as_stated": not others,
        "claims": claims,
        "sets": {label: _set(experiments, result) for label, result in experiments.results.items()},
        "examples": {name: _example(experiments, reduction) for name, reduction in experiments.reductions.items()},
        "linear_models": {
            name: {**model_summary(model), "modes": mode_summaries(model)}
            for name, model in final_models(experiments).items()
        },
        "figures": _figures(experiments),
        "compared": _figures(experiments.compared) if experiments.compared else None,
        "physical_modes": [
            PayloadMode(payload, mode.frequency, mode.damping)
            for payload, physical in experiments.physical.items()
            for mode in physical
        ],
        "tables": {table.number: table for table in found},
        "data": data_summary(experiments.recorded),
        "units": unit_documents(experiments.recorded),
        "versions": versions(),
        "warnings": [*warnings_of(experiments), *others],
        "verdict": {
            "at_least": None,
            "reached": None,
            "held": not others,
            "converged": True,
            "said": f"{len(claims) - len(others)} of {len(claims)} claims come out as the study states",
        },
    }


def calibrated(experiments: Experiments, folder: Path) -> Calibrated:
    """Every chosen and updated model as an FMU."""
    models = final_models(experiments)
    return Calibrated({name: linear_fmu(model, folder / f"{name}.fmu") for name, model in models.items()})


def final_models(experiments: Experiments) -> dict[str, LinearModel]:
    """In the signals' own units: the chosen model of each data set, and the updated ones of each example."""
    found = {}
    for result in experiments.results.values():
        found[model_name(result)] = result.ready.unscaled(result.chosen.model)
        for reduction in result.reductions:
            found |= {reduced_name(reduction, stage): result.ready.unscaled(stage.model) for stage in reduction.final}
    return found


def warnings_of(experiments: Experiments) -> list[str]:
    """What a reader of the figures must know."""
    sets = [result.data_set for result in experiments.results.values()]
    touched = [f"{own.code} ({own.stop:.2g} s)" for own in sets if own.removed and own.stop > 0]
    unstable = [label for label, result in experiments.results.items() if not result.stable]
    warnings = []
    if touched:
        warnings.append(
            f"the arm touched an end stop in {', '.join(touched)}; the thesis would have ended the experiment"
        )
    if unstable:
        warnings.append(f"no order of the range is stable for {', '.join(unstable)}; the best of all is shown")
    return warnings


def _figures(experiments: Experiments) -> dict[str, float | None]:
    return {name: finite(value) for name, value in figures(experiments).items()}


def _set(experiments: Experiments, result: SetResult) -> SetSummary:
    known = experiments.study.sets[result.data_set.code]
    return {
        "experiment": known.experiment,
        "excitation": known.excitation,
        "volts": known.volts,
        "rate": known.rate,
        "payload": known.payload,
        "samples": known.samples,
        "compensation": known.compensation,
        "compensation_removed": result.data_set.removed,
        "stable_orders": result.stable,
        "order": result.chosen.order,
        "stop_time": result.data_set.stop,
        "frequency_distances": [finite(distance) for distance in result.frequencies],
        "by_order": {
            str(attempt.order): AttemptSummary(attempt.model.stable, attempt.errors.dmv, attempt.errors.sfv)
            for attempt in result.attempts
        },
        "model": model_name(result),
    }


def _example(experiments: Experiments, reduction: ReductionExample) -> ExampleSummary:
    example, ranking = experiments.example(reduction.example.name), reduction.ranking
    return {
        "data": example.data,
        "compensation_removed": example.removed,
        "ranking": list(map(ModeRank, ranking.labels, ranking.mrm, ranking.msv)),
        "stages": {
            stage.name: StageSummary(stage.kept, stage.model.order, stage.errors.dmv, stage.errors.sfv)
            for stage in reduction.stages
        },
    }
