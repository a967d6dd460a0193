"""The folder that a calibration leaves, whatever its method: `summary.json` as types, and what all summaries share."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, Protocol

import numpy as np
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from fmus.errors import IdentificationError, InputError
from identification.estimation.estimated_value import EstimatedValue, PriorKnowledge
from identification.fits import FitSummary, WorstSummary, told
from identification.messages import MessagesSummary
from identification.recordings.campaign import StudyTrace, recording_warnings
from orchestrator.crossing import Crossing, CrossingDocument, documents_of, noted
from orchestrator.fmi.interface import Value
from orchestrator.marks import Mark
from orchestrator.results import versions
from orchestrator.trace import FloatArray

STUDY = "study.yaml"
SUMMARY = "summary.json"
GROUPS = "groups"  # folder of parameter sets, one a group of recordings
POOR = 0.5  # median FIT below which what was seen in recordings may have spoilt it
MOST = 1000  # marks of a recording that are told


class ParameterSummary(TypedDict):
    """A parameter's estimate, all in `unit`; what is not determined is null.

    Attributes:
        prior: what was known of it before, where something was.
        start: where its estimation began; null for one that is tied to another.
        truth: what is behind synthetic traces, where a study tells.
        of: the parameter that it is the value of in a group of recordings; its own name is `of@group`.
    """

    value: float
    std: float | None
    ci95: list[float | None] | None
    unit: str
    start: Value | None
    truth: NotRequired[float]
    of: NotRequired[str]
    prior: NotRequired[PriorKnowledge]


def parameter_summary(
    found: EstimatedValue, start: Value | None = None, truth: float | None = None
) -> ParameterSummary:
    """The entry of an estimate."""
    entry: ParameterSummary = {
        "value": found.value,
        "std": finite(found.std),
        "ci95": [finite(end) for end in found.ci95] if found.known else None,
        "unit": found.unit,
        "start": start,
    }
    if truth is not None:
        entry["truth"] = truth
    return entry


class FitsSummary(TypedDict, total=False):
    """FIT on fitted traces and on those kept aside (null where there are none), and of the study's `compare`."""

    train: FitSummary
    validation: FitSummary | None
    compared: dict[str, FitSummary]


class TraceSummary(TypedDict):
    """A recording: where it comes from, its hash, what was found in it, and whether it was fitted or held out.

    Attributes:
        left_out: how much of it [s], where some is; and the first `MOST` marks for which it is.
    """

    trace: str
    file: str
    sha256: str
    stamps: str
    role: str
    notes: NotRequired[list[str]]
    left_out: NotRequired[float]
    marks: NotRequired[list[Mark]]


class VerdictSummary(TypedDict):
    """Whether a result is what its study asks for.

    Attributes:
        at_least: the median FIT asked for, null without a target; `reached` is what counts against it.
        worst_at_least: the FIT asked for of every window and output, null without; `worst` is what counts against it.
        held: whether the target is reached, or claims come out as stated: the exit code is 1 where it is not.
        converged: whether the search came to its end.
        said: all that in a line, with what to do; nothing where there is no target and nothing to do.
    """

    at_least: float | None
    reached: float | None
    worst_at_least: NotRequired[float | None]
    worst: NotRequired[WorstSummary | None]
    held: bool
    converged: bool
    said: str


class Summary(TypedDict):
    """What `summary.json` holds, whatever the method; each adds keys of its own.

    Attributes:
        messages: what the FMUs said meanwhile; null where they said nothing.
    """

    title: str
    method: str
    parameters: dict[str, ParameterSummary]
    fit: FitsSummary
    data: list[TraceSummary]
    units: NotRequired[list[CrossingDocument]]
    versions: dict[str, str]
    warnings: list[str]
    verdict: NotRequired[VerdictSummary]
    messages: NotRequired[MessagesSummary | None]


class ValidationSummary(TypedDict):
    """What a validation's `summary.json` holds.

    Attributes:
        fit: "unseen" and "fitted": recordings that the fit did not use, and those that it did.
        held: whether the study's target `at_least` is met, by the unseen ones where there are some.
    """

    title: str
    fit: dict[str, FitSummary]
    at_least: float | None
    held: bool
    data: list[TraceSummary]
    units: list[CrossingDocument]
    versions: dict[str, str]
    warnings: list[str]
    verdict: VerdictSummary
    messages: NotRequired[MessagesSummary | None]


def verdict(
    fit: FitSummary,
    side: str,
    at_least: float | None,
    *,
    worst_at_least: float | None = None,
    unsettled: str = "",
    remedy: str = "",
    recorded: Iterable[StudyTrace] = (),
) -> VerdictSummary:
    """The verdict on a median FIT, and on the worst one.

    Args:
        side: whose FIT it is, such as "unseen".
        unsettled: why the search has not converged, and what to do; nothing where it has.
        remedy: what to try where the target is missed.
        recorded: where something was seen in these that may spoil a fit, it has to be `POOR` at least without a target.
    """
    reached, worst = fit["median"], fit.get("worst")
    spoilt = at_least is None and any(recording.damaged for recording in recorded)
    least = POOR if spoilt else at_least
    held = _reaches(reached, least)
    said = []
    if spoilt and not held:
        found = "none" if reached is None else f"{reached:.4f}"
        said = [f"DOUBTFUL: median FIT, {side}, {found}, of recordings that are not sound (see the warnings)"]
    if at_least is not None:
        found = "none" if reached is None else f"{reached:.4f}"
        said = [f"{'held' if held else 'MISSED'}: median FIT, {side}, {found}, at least {at_least:g} asked for"]
    if worst_at_least is not None:
        holds = _reaches(worst["fit"] if worst else None, worst_at_least)
        found = f"worst FIT, {side}, {told(worst)}, at least {worst_at_least:g} asked for"
        said.append(f"{'held' if holds else 'MISSED'}: {found}")
        held = held and holds
    if not held and remedy:
        said.append(remedy)
    if unsettled:
        said.append(f"NOT CONVERGED: {unsettled}")
    return {
        "at_least": at_least,
        "reached": reached,
        "worst_at_least": worst_at_least,
        "worst": worst,
        "held": held,
        "converged": not unsettled,
        "said": "; ".join(said),
    }


class FitTarget(Protocol):
    """What a study asks of FIT."""

    @property
    def title(self) -> str: ...

    @property
    def at_least(self) -> float | None: ...

    @property
    def worst_at_least(self) -> float | None: ...


def validation_summary(
    study: FitTarget,
    sides: Mapping[str, FitSummary],
    recorded: Sequence[StudyTrace],
    unseen: Iterable[str],
    units: Sequence[Crossing] = (),
) -> ValidationSummary:
    """What a validation's `summary.json` holds; the first side is held against the study's target.

    Args:
        sides: "unseen" and "fitted" -> FIT, of those that there are.
        unseen: names of the recordings that the fit did not use.
        units: how signals of windows got to the units of their variables, over those of the recordings.
    """
    side = next(iter(sides))
    judged = verdict(sides[side], side, study.at_least, worst_at_least=study.worst_at_least, recorded=recorded)
    nothing_new = "every recording was used in the fit; this judges nothing new"
    return {
        "title": study.title,
        "fit": dict(sides),
        "at_least": study.at_least,
        "held": judged["held"],
        "data": data_summary(recorded, unseen),
        "units": documents_of(noted([*(crossed for one in recorded for crossed in one.crossings), *units])),
        "versions": versions(),
        "warnings": [
            *([] if "unseen" in sides else [nothing_new]),
            *(str(crossing) for crossing in units if crossing.doubtful),
            *recording_warnings(recorded),
        ],
        "verdict": judged,
    }


def _reaches(fit: float | None, least: float | None) -> bool:
    return least is None or (fit is not None and fit >= least)


def read_summary(folder: Path) -> Summary:
    """The summary in a result folder.

    Raises:
        InputError: there is none, or it is not a calibration's.
    """
    file = result_file(folder, SUMMARY)
    try:
        return TypeAdapter(Summary).validate_python(json.loads(file.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(file, f"is not a calibration's summary ({place}: {first['msg']})", "calibrate again") from None
    except ValueError as error:
        raise InputError(file, f"is not a calibration's summary ({error})", "calibrate again") from error


def covariance_in(folder: Path) -> tuple[list[str], FloatArray] | None:
    """Names of the n free parameters, and their covariance (n, n) in the product of their units as a result's summary
    has it, nan of what is not determined; None where it has none.

    Raises:
        IdentificationError: what stands there is no covariance.
    """
    document: Any = json.loads(result_file(folder, SUMMARY).read_text(encoding="utf-8"))
    try:
        found = document.get("uncertainty", {}).get("covariance")
        if found is None:
            return None
        names = [str(name) for name in found["parameters"]]
        matrix = [[math.nan if value is None else float(value) for value in row] for row in found["matrix"]]
        return names, np.array(matrix, dtype=float).reshape(len(names), len(names))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise IdentificationError(folder, f"has a covariance that is none ({error})", "calibrate again") from None


def result_file(folder: Path, name: str) -> Path:
    """A file of a result folder.

    Raises:
        InputError: it is not there.
    """
    if not (folder / name).is_file():
        raise InputError(folder, f"holds no {name}", "give a folder that `servotwin calibrate` wrote")
    return folder / name


def by_use(recorded: Iterable[StudyTrace], earlier: Summary) -> dict[str, list[StudyTrace]]:
    """ "unseen" and "fitted" -> those that a fit did not use, by their hashes, and those that it did."""
    used = {trace["sha256"] for trace in earlier["data"] if trace["role"] == "fit"}
    groups: dict[str, list[StudyTrace]] = {"unseen": [], "fitted": []}
    for recording in recorded:
        groups["fitted" if recording.sha256 in used else "unseen"].append(recording)
    return groups


def data_summary(recorded: Iterable[StudyTrace], held_out: Iterable[str] = ()) -> list[TraceSummary]:
    """File, hash and role of each trace, and the notes on its file where there are some."""
    kept = set(held_out)
    entries: list[TraceSummary] = []
    for recording in recorded:
        entry: TraceSummary = {
            "trace": recording.trace.name,
            "file": recording.source.name,
            "sha256": recording.sha256,
            "stamps": recording.stamps,
            "role": "held out" if recording.trace.name in kept else "fit",
        }
        if recording.remarks:
            entry["notes"] = list(recording.remarks)
        if recording.marks:
            entry["left_out"] = recording.left_out
            entry["marks"] = list(recording.marks[:MOST])
        entries.append(entry)
    return entries


def finite(value: float) -> float | None:
    """The value, None when it is infinite or NaN, as JSON has neither."""
    return value if math.isfinite(value) else None
