"""A design from its study: the experiments, what they are predicted to tell, and what others would."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus import units
from fmus.errors import ScenarioError
from identification.design.bench import DesignBench, information, roughly
from identification.design.criteria import figure, half_widths
from identification.design.search import FoundExperiments, TriedExperiment, search
from identification.design.study import DesignStudy, DurationTrial
from identification.estimation.arrow_least_squares import LEAST_SQUARES
from identification.estimation.threads import single_threaded
from identification.recordings.campaign import FileField
from orchestrator.fmi.interface import Value
from orchestrator.progress import Progress, silent
from orchestrator.trace import FloatArray

DRAWS = 6  # of noise, for what is predicted
_FIELD = re.compile(r"\{([\w.\[\],]+)(?: ([^{}]+))?\}")


@dataclass(frozen=True, eq=False)
class Design:
    """What a study of a design gave.

    Attributes:
        experiments: name -> experiment.
        before, after: (n,) half-widths of the 95 % intervals of the free parameters [unit each], known and predicted;
            before is None where nothing is known.
        compared: name -> (n,) those of other experiments, with what is known.
        units: of the parameters, of what is limited, driven and varied.
        channels: seeds of the rig's noise, component.variable.
        remarks: what a reader must know.
        trials: the durations that were tried, ascending, where one was sought.
    """

    study: DesignStudy
    found: FoundExperiments
    experiments: Mapping[str, TriedExperiment]
    before: FloatArray | None
    after: FloatArray
    compared: Mapping[str, FloatArray]
    units: Mapping[str, str]
    channels: tuple[str, ...]
    remarks: tuple[str, ...]
    trials: tuple[DurationTrial, ...] = ()

    @property
    def reached(self) -> bool:
        """Whether half-widths are what was asked for, where a duration was sought for that."""
        return not self.trials or any(one.of_target <= 1 for one in self.trials)

    @property
    def names(self) -> list[str]:
        """Of the free parameters."""
        return [parameter.name for parameter in self.study.calibration.parameters.free]

    def relative(self, widths: FloatArray) -> FloatArray:
        """(k,) half-widths of the parameters that the design is about, as parts of their values (of sizes at 0)."""
        free = {parameter.name: parameter for parameter in self.study.calibration.parameters.free}
        every = dict(zip(self.names, widths, strict=True))
        return np.array([every[name] / free[name].size for name in self.study.parameters])

    def noise(self, candidate: TriedExperiment) -> dict[str, float]:
        """Output -> standard deviation of a compared sample of an experiment."""
        return dict(zip(self.study.calibration.outputs, map(float, candidate.tried.noise), strict=True))

    def alone(self, candidate: TriedExperiment) -> float:
        """The criterion's figure if all experiments were this one."""
        free = self.names
        whole = roughly([candidate.tried] * self.study.count)
        whole = whole if self.study.known is None else whole + self.study.known
        return figure(whole, self.study.criterion, [free.index(name) for name in self.study.parameters])


@single_threaded
def design(study: DesignStudy, progress: Progress = silent) -> Design:
    """The experiments that a study asks for.

    Raises:
        InputError: rig, calibration and what may differ do not fit together; or no experiment that is allowed shows all
            parameters.
        FmuError: the FMUs fail.
    """
    progress(0.0, "building")
    with DesignBench(study) as bench:
        found = search(study, bench, progress)
        progress(0.9, "drawing other noise")
        after = _drawn(bench, [one.tried.values for one in found.chosen])
        others = {name: [_case(bench, case) for case in cases] for name, cases in study.compare.items()}
        compared = {name: _drawn(bench, values) for name, values in others.items()}
        unit = {name: bench.unit(name) for family in study.families for name in study.space(family)}
        unit |= {name: bench.unit(name) for name in study.limits} | bench.units
        remarks, channels = _remarks(study, found, bench), bench.channels
    size = len(study.calibration.parameters.free)
    known = np.zeros((size, size)) if study.known is None else study.known
    slopes = study.calibration.parameters.slopes(np.zeros(size))

    def widths(told: FloatArray) -> FloatArray:
        return slopes * half_widths(known + told)

    return Design(
        study,
        found,
        _named(study, found.chosen),
        None if study.known is None else slopes * half_widths(known),
        widths(after),
        {name: widths(told) for name, told in compared.items()},
        unit,
        channels,
        remarks,
    )


def _drawn(bench: DesignBench, experiments: Sequence[Mapping[str, Value]]) -> FloatArray:
    """(n, n) what experiments tell together, the mean over noise that the search has not seen: what it picks it has
    also picked for its luck."""
    rows = [bench.again(values, draw) for draw in range(1, DRAWS + 1) for values in experiments]
    return information(rows) / DRAWS


def _case(bench: DesignBench, name: str) -> dict[str, Value]:
    """What a case of the rig's scenario sets; parameters that are known do not count."""
    cases = {case.name: case for case in bench.study.rig.cases}
    if name not in cases:
        raise ScenarioError(f"compare.{name}", "is no case of the scenario", f"there are {', '.join(cases)}")
    hidden = {*bench.study.values, *bench.channels}
    return {key: value for key, value in cases[name].values.items() if key not in hidden}


def _named(study: DesignStudy, chosen: Sequence[TriedExperiment]) -> dict[str, TriedExperiment]:
    """The experiments by their names, which tell the calibration what it takes from names of files."""
    named: dict[str, TriedExperiment] = {}
    for number, candidate in enumerate(chosen, 1):
        named[name_of(study.names, number, candidate.tried.values)] = candidate
    if len(named) < len(chosen):
        raise ScenarioError("name", f"'{study.names}' gives two experiments one name", "put {number} into it")
    for name, candidate in named.items():
        _require_told(study, name, candidate.tried.values)
    return named


def name_of(template: str, number: int, values: Mapping[str, Value]) -> str:
    """A template with its fields filled in: `{number}`, and `{component.variable unit}` in a unit.

    Raises:
        ScenarioError: a field is not known, or no number.
    """

    def filled(match: re.Match[str]) -> str:
        name, unit = match[1], match[2]
        value = number if name == "number" else values.get(name)
        if value is None:
            raise ScenarioError("name", f"{{{name}}} is no value that differs", "vary it, or leave it out")
        if unit is None:
            return f"{value:.10g}" if isinstance(value, float) else str(value)
        known = units.parse(unit)
        if known is None or isinstance(value, str):
            raise ScenarioError(
                "name", f"{{{match[0][1:-1]}}} is no number in a unit that is known", "write {hand.added_mass g}"
            )
        return f"{(float(value) - known.offset) / known.factor:.10g}"

    return _FIELD.sub(filled, template)


def _require_told(study: DesignStudy, name: str, values: Mapping[str, Value]) -> None:
    """See that a name tells what the calibration takes from the names of files."""
    source = study.calibration.traces
    if source.files is None or source.file_name is None:
        return
    match = re.fullmatch(source.file_name.pattern, name)
    wanted = {variable: field for variable, field in source.values.items() if variable in values}
    for variable, field in wanted.items():
        rule, value = source.file_name.fields.get(field), values[variable]
        told = _number(rule, match[field] or "") if match and rule else None
        if told is None or isinstance(value, str) or not np.isclose(told, float(value), rtol=1e-6, atol=0):
            problem = f"'{name}' does not tell the calibration {field}, from which it takes {variable}"
            fix = f"write a `name` after its pattern {source.file_name.pattern}"
            raise ScenarioError("name", problem, fix)


def _number(rule: FileField, digits: str) -> float | None:
    """The number in a name; None where it is none."""
    try:
        return rule.number(digits)
    except ValueError:
        return None


def _remarks(study: DesignStudy, found: FoundExperiments, bench: DesignBench) -> tuple[str, ...]:
    remarks = []
    if bench.elsewhere:
        remarks.append(f"not in the rig's scenario, which runs without them: {', '.join(bench.elsewhere)}")
    if bench.differences:
        remarks.append(f"information is by differences, not by exact tangents: {bench.differences}")
    if len(study.calibration.outputs) > 1:
        remarks.append(
            "outputs count by their noise here; a calibration that weighs them otherwise has somewhat wider intervals"
        )
    if study.calibration.loss != LEAST_SQUARES:
        remarks.append("the calibration's loss is robust: its intervals are somewhat wider than those of least squares")
    read = [name for name, spec in study.calibration.run.initial.items() if not spec.estimated]
    if read:
        remarks.append(
            f"start values are read and not estimated ({', '.join(read)}): they scatter as no noise model tells, and "
            "predictions are rough; set `estimated: true` in the calibration's study"
        )
    if found.failed:
        remarks.append(f"some experiments could not be simulated; the first: {found.failed[0]}")
    return tuple(remarks)
