"""An axis' parameters from its recordings: least squares, and instrumental variables where its loop is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError
from identification.built_system import BuiltSystem
from identification.estimation.estimated_value import EstimatedValue, with_interval
from identification.estimation.validation import fit
from identification.inverse_dynamics.regression import Regression, RegressionRows, regress
from identification.inverse_dynamics.rows import AxisRecord, FilteredRecord, prepared, with_instruments
from identification.inverse_dynamics.steadiness import Shift, shifts
from identification.inverse_dynamics.study import Filtering, InverseDynamicsStudy, Way
from identification.inverse_dynamics.system import AxisSystem, checked
from identification.inverse_dynamics.terms import PASSIVE, Term
from identification.recordings.campaign import StudyTrace, load_campaign, recording_warnings, split
from identification.recordings.marks import nothing_left, pieces, require_known
from identification.recordings.units import in_units
from identification.signals.processing import mean_step
from orchestrator.assembly.assembly import OpenSystem
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, share_of, silent
from orchestrator.trace import FloatArray

ROUNDS = 20
SETTLED = 1e-4  # of a standard deviation, by which a round may change a value


@dataclass(frozen=True, eq=False)
class Regressed:
    """What one way gave.

    Attributes:
        parameters: term -> value [unit of its parameter].
        shifts: what becomes of the values when motions are prepared otherwise.
        rounds: of the axis run in its loop; 0 for least squares.
        settled: whether the last round changed nothing to speak of.
    """

    parameters: Mapping[Term, EstimatedValue]
    shifts: tuple[Shift, ...]
    rounds: int = 0
    settled: bool = True

    @property
    def values(self) -> dict[Term, float]:
        """The values alone."""
        return {term: one.value for term, one in self.parameters.items()}


@dataclass(frozen=True, eq=False)
class InverseCalibration:
    """What a study gave.

    Attributes:
        system: the FMUs as they were before.
        before: term -> value there.
        found: way -> what it gave.
        rows: of all records, those kept aside too.
    """

    study: InverseDynamicsStudy
    system: BuiltSystem
    recorded: tuple[StudyTrace, ...]
    before: Mapping[Term, float]
    found: Mapping[Way, Regressed]
    rows: tuple[FilteredRecord, ...]

    @property
    def taken(self) -> Regressed:
        """What is written."""
        return self.found[self.study.take]

    def predicted(self, one: FilteredRecord) -> FloatArray:
        """(K,) force on a record's rows by what is written."""
        return np.asarray(one.x @ np.array([self.taken.values[term] for term in self.study.write]))

    def fits(self, *, aside: bool) -> dict[str, float]:
        """Recording -> FIT of its force, of those kept aside or of the others."""
        held_out = self.study.traces.hold_out
        by_trace: dict[str, list[FilteredRecord]] = {}
        for one in self.rows:
            if (one.record.trace in held_out) == aside:
                by_trace.setdefault(one.record.trace, []).append(one)
        return {trace: self._fit(own) for trace, own in by_trace.items()}

    def _fit(self, rows: Sequence[FilteredRecord]) -> float:
        explained = np.concatenate([self.predicted(one) for one in rows])
        return float(fit(np.concatenate([one.y for one in rows]), explained)[0])

    @property
    def warnings(self) -> list[str]:
        """What a reader of the figures must know."""
        moved = [shift.told(self.study.write, self.taken.values) for shift in self.taken.shifts]
        own = [*_indistinct(self.study), *_bounds(self), *filter(None, moved), *_apart(self)]
        return [*own, *recording_warnings(self.recorded)]


def calibrate(
    study: InverseDynamicsStudy,
    data: Path | None = None,
    progress: Progress = silent,
    isolation: Isolation | None = None,
) -> InverseCalibration:
    """Regress the force of an axis on its motion.

    Args:
        data: the recordings, over the study's own.
        isolation: of FMUs whose runs are the recordings.

    Raises:
        InputError: the study, its system and its traces do not fit together, or the motions do not tell.
    """
    system = BuiltSystem(study.system, [study.axis.input])
    with OpenSystem(system.assembled) as opened:
        known = checked(study, opened.system)
    loaded = load_campaign(study.traces, data, share_of(progress, 0.0, 0.6), isolation)
    recorded = in_units(loaded, known.units)
    terms = list(study.write)
    rows = tuple(
        prepared(record, study.filtering, terms) for trace in recorded for record in _records(study, trace, known)
    )
    fitted = {trace.trace.name for trace in split(list(recorded), study.traces.hold_out)[0]}
    train = [one for one in rows if one.record.trace in fitted]
    progress(0.7, "least squares")
    found: dict[Way, Regressed] = {"least-squares": _least_squares(study, train, known)}
    if study.loop is not None:
        found["instrumental"] = _instrumental(study, train, found["least-squares"], known, progress)
    return InverseCalibration(study, system, tuple(recorded), known.before, found, rows)


def _records(study: InverseDynamicsStudy, recorded: StudyTrace, known: AxisSystem) -> list[AxisRecord]:
    """What is left of a trace between its marks, at even instants; what is too short to filter is not.

    Raises:
        TraceError: a signal is missing, or marks leave nothing.
    """
    axis, loop, filtering = study.axis, study.loop, study.filtering
    held = [axis.command, *([loop.reference] if loop else [])]
    trace = recorded.trace.select([axis.position, *held])
    shortest = 5 / min(filtering.cutoff, filtering.rows_per_second)
    kept = [piece for piece in pieces(trace, recorded.marks) if piece.duration > shortest]
    if not kept:
        raise nothing_left(recorded.place, f"no {shortest:.2g} s are", recorded.marks)
    require_known(recorded.excluded_as, kept, trace.names)
    step, records = mean_step(trace.time), []
    for number, piece in enumerate(kept):
        even = piece.resampled(piece.time[0] + step * np.arange(int(piece.duration / step * (1 + 1e-9)) + 1), hold=held)
        force = known.gain * even[axis.command]
        force = 0.5 * (force + np.concatenate((force[:1], force[:-1])))
        name = trace.name if len(kept) == 1 else f"{trace.name}, piece {number + 1}"
        reference = even[loop.reference] if loop else None
        records.append(AxisRecord(name, trace.name, step, even[axis.position], force, reference, float(piece.time[0])))
    return records


def _least(terms: Sequence[Term]) -> FloatArray:
    """(n,) the least that is physically feasible."""
    return np.array([0.0 if term in PASSIVE or term == "inertia" else -np.inf for term in terms])


def _least_squares(study: InverseDynamicsStudy, rows: Sequence[FilteredRecord], known: AxisSystem) -> Regressed:
    terms, least = list(study.write), _least(list(study.write))

    def regressed(filtered: Iterable[FilteredRecord]) -> Regression:
        return regress([RegressionRows(one.y, one.x, one.x, one.kept) for one in filtered], least)

    found = regressed(rows)
    moved = shifts(
        found, study.filtering, rows, lambda how: regressed(prepared(one.record, how, terms, one.kept) for one in rows)
    )
    return Regressed(_estimates(found, moved, terms, known), moved)


def _instrumental(
    study: InverseDynamicsStudy, rows: Sequence[FilteredRecord], start: Regressed, known: AxisSystem, progress: Progress
) -> Regressed:
    """Rounds of running the axis in its loop by the values found, and regressing with that as instruments."""
    assert study.loop is not None
    loop, terms, values, least = study.loop, list(study.write), start.values, _least(list(study.write))

    def regressed(filtered: Iterable[FilteredRecord], how: Filtering) -> Regression:
        return regress([with_instruments(one, how, loop, values, terms, known.gain) for one in filtered], least)

    for number in range(1, ROUNDS + 1):
        progress(0.7 + 0.3 * number / ROUNDS, "instrumental variables")
        found = regressed(rows, study.filtering)
        change = np.abs(found.values - np.array([values[term] for term in terms]))
        _forwards(found, terms)
        values = dict(zip(terms, found.values.tolist(), strict=True))
        settled = bool(np.all(change <= SETTLED * np.sqrt(np.diag(found.covariance))))
        if settled:
            break
    moved = shifts(
        found,
        study.filtering,
        rows,
        lambda how: regressed((prepared(one.record, how, terms, one.kept) for one in rows), how),
    )
    return Regressed(_estimates(found, moved, terms, known), moved, number, settled)


def _estimates(
    found: Regression, moved: Iterable[Shift], terms: Sequence[Term], known: AxisSystem
) -> dict[Term, EstimatedValue]:
    """The values with their intervals, shifts in these; one at the least that is feasible has none."""
    _forwards(found, terms)
    stds = np.where(found.bound, np.inf, np.sqrt(np.diag(found.covariance)))
    off = np.sum([np.abs(shift.by) for shift in moved], axis=0)
    return {
        term: with_interval(float(value), float(std), found.freedom, known.parameter_units[term], float(by))
        for term, value, std, by in zip(terms, found.values, stds, off, strict=True)
    }


def _forwards(found: Regression, terms: Sequence[Term]) -> None:
    """See that force moves the axis its own way.

    Raises:
        IdentificationError: no inertia is left.
    """
    if not found.values[terms.index("inertia")] > 0:
        raise IdentificationError(
            "write.inertia",
            "the motions ask for a negative one",
            "check the command's sign and gain, or record motions that accelerate",
        )


def _indistinct(study: InverseDynamicsStudy) -> list[str]:
    written = set(study.write)
    if {"coulomb_positive", "coulomb_negative"} <= written:
        return [
            "Coulomb friction that differs by direction and a constant offset are the same force: half of the "
            "difference may be an offset, and only the mean of both is friction for sure"
        ]
    if {"coulomb", "offset"} <= written:
        return ["the offset may be Coulomb friction that differs by direction, by twice as much: it is the same force"]
    return []


def _bounds(result: InverseCalibration) -> list[str]:
    return [
        f"{result.study.write[term]} is 0, the least that is feasible: the motions ask for a negative one"
        for term, one in result.taken.parameters.items()
        if term in PASSIVE and one.value == 0
    ]


def _apart(result: InverseCalibration) -> list[str]:
    """Where the ways, or others, disagree by more than the intervals say, which then miss what the model lacks."""
    said = []
    others = {name: dict(values) for name, values in result.study.compare.items()}
    for way, found in result.found.items():
        if way != result.study.take:
            others[way] = {result.study.write[term]: value for term, value in found.values.items()}
    for name, values in others.items():
        outside = {
            target: abs(values[target] - one.value) / (0.5 * (one.ci95[1] - one.ci95[0]))
            for term, one in result.taken.parameters.items()
            if (target := result.study.write[term]) in values and one.known
        }
        beyond = [f"{target} by {half:.2g}" for target, half in outside.items() if half > 1]
        if beyond:
            said.append(
                f"{name} lies outside of the 95 % intervals, in half widths: {', '.join(beyond)}; intervals allow for "
                "noise, not for what the model lacks"
            )
    return said
