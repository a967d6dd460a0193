"""The study file of a design."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from fmus.errors import IdentificationError, ScenarioError
from identification.design.study import (
    Choice,
    Criterion,
    DesignStudy,
    Limit,
    ListedValues,
    SearchSpec,
    Sought,
    ValueRange,
)
from identification.estimation.parameters import ParameterSet
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.study import OutputErrorStudy
from identification.recordings.schema import StudyBlock
from identification.results import covariance_in, read_summary
from orchestrator.rational import seconds
from orchestrator.scenario.expectations.quantities import Share
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import FloatArray
from orchestrator.yaml_file import Block, Seconds, Time, load


class SpanBlock(Block):
    """All values from `min` to `max` [the variable's unit].

    Attributes:
        min, max: the ends, both included.
    """

    min: float
    max: float

    @model_validator(mode="after")
    def _spans(self) -> SpanBlock:
        if not self.min < self.max:
            raise ValueError("`min` must be below `max`")
        return self

    def choice(self) -> Choice:
        """As a plain value."""
        return ValueRange(self.min, self.max)


class OneOfBlock(Block):
    """One of some values.

    Attributes:
        one_of: the values.
    """

    one_of: list[float | int | bool | str] = Field(min_length=1)

    def choice(self) -> Choice:
        """As a plain value."""
        return ListedValues(tuple(self.one_of))


def _choice(value: Any) -> Any:
    """A single value or a list as the options that they are short for."""
    if isinstance(value, dict):
        return value
    return {"one_of": value if isinstance(value, list) else [value]}


Short = float | int | bool | str | list[float | int | bool | str]
ChoiceBlock = Annotated[
    SpanBlock | OneOfBlock, BeforeValidator(_choice, json_schema_input_type=Short | SpanBlock | OneOfBlock)
]


class ResponseLimitBlock(Block):
    """Within which a variable has to stay, as an expectation says it [the variable's unit].

    Attributes:
        above, below: every sample lies above, or below, this value.
    """

    above: float | None = None
    below: float | None = None

    @model_validator(mode="after")
    def _limits(self) -> ResponseLimitBlock:
        if self.above is None and self.below is None:
            raise ValueError("give `above`, `below` or both")
        if not self.limit().above < self.limit().below:
            raise ValueError("`above` must be less than `below`")
        return self

    def limit(self) -> Limit:
        """As a plain value."""
        given = {"above": self.above, "below": self.below}
        return Limit(**{key: end for key, end in given.items() if end is not None})


class DesignSearchBlock(Block):
    """How experiments are sought."""

    explained_by = (SearchSpec,)

    candidates: int = Field(SearchSpec.candidates, ge=1, le=100_000)
    rounds: int = Field(SearchSpec.rounds, ge=0, le=1000)
    neighbours: int = Field(SearchSpec.neighbours, ge=1, le=10_000)
    seed: int = Field(SearchSpec.seed, ge=0)


class DurationBlock(Block):
    """A duration that is to be found: the shortest after which half-widths of 95 % intervals are small enough.

    Attributes:
        between: the shortest and the longest that may be [s], or with their unit: `[3 s, 9 s]`.
        half_width: the largest of all parameters that the design is about, as a part of its value, `5 %`; or by
            parameter in its unit.
        within: how nearly the shortest is told [s]; an eighth of the span by default.
    """

    between: Annotated[list[Time], Field(min_length=2, max_length=2)]
    half_width: Share | dict[str, Annotated[float, Field(gt=0)]]
    within: Annotated[Time, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _spans(self) -> DurationBlock:
        low, high = self.between
        if not 0 < low < high:
            raise ValueError("`between` needs two times above 0, the shorter one first")
        if not self.half_width or (isinstance(self.half_width, float) and self.half_width < 0):
            raise ValueError("`half_width` needs a share above 0, or parameters with theirs")
        return self

    def longest(self) -> tuple[Sought, Fraction]:
        """As a plain value, and the longest duration [s]."""
        low, high = (seconds(repr(end)) for end in self.between)
        within = (high - low) / 8 if self.within is None else seconds(repr(self.within))
        if isinstance(self.half_width, dict):
            return Sought(low, high, within, each=dict(self.half_width)), high
        return Sought(low, high, within, self.half_width), high


def _kind(value: Any) -> str:
    return "sought" if isinstance(value, dict | DurationBlock) else "given"


DurationEntry = Annotated[
    Annotated[Seconds, Tag("given")] | Annotated[DurationBlock, Tag("sought")], Discriminator(_kind)
]


class ExperimentDesignBlock(StudyBlock):
    """A study that finds the experiments after which a calibration's intervals are smallest.

    Attributes:
        calibration: a study of `method: output-error`, which will take the recordings.
        result: the folder of a calibration: its estimates are where the design is made, its covariance is what is
            known already; without, that is what priors of the calibration's study say.
        values: parameters as they are known, over those of the result and the starts of the calibration's study.
        scenario: of the rig: what drives it, sensors and recorder; its values of calibrated parameters do not count.
        experiments: how many.
        duration: of each [s]; or between which it is sought, for which half-widths.
        families: name -> component.variable of the rig -> a value, a list of values, or `{min: , max: }`.
        vary: what may differ in every family: an added mass, a set-point.
        amplitude: the variable of a family that is made smaller where a limit is exceeded.
        limits: component.variable of the rig -> `above`, `below`.
        criterion: D the volume, A the mean square, E the longest axis of the relative intervals' ellipsoid; worst the
            largest relative half-width.
        parameters: those that it is about; all that the calibration frees by default.
        noise: output of the calibration -> standard deviation of a compared sample [its unit], over what the rig's
            sensors give.
        compare: name -> cases of the scenario, which are predicted beside the design.
        name: of an experiment and so of its recording: text with `{number}`, and `{hand.added_mass g}` for a value in a
            unit, as the calibration's `file_name` reads it.
    """

    method: Literal["design"]
    calibration: Path
    result: Path | None = None
    values: dict[str, float] = {}
    scenario: Path
    experiments: int = Field(1, ge=1, le=100)
    duration: DurationEntry
    families: dict[str, dict[str, ChoiceBlock]] = Field(min_length=1)
    vary: dict[str, ChoiceBlock] = {}
    amplitude: str | None = None
    limits: dict[str, ResponseLimitBlock] = {}
    criterion: Criterion = DesignStudy.criterion
    parameters: list[str] = []
    noise: dict[str, Annotated[float, Field(gt=0)]] = {}
    compare: dict[str, Annotated[list[str], Field(min_length=1)]] = {}
    name: str = DesignStudy.names
    search: DesignSearchBlock = DesignSearchBlock()

    @model_validator(mode="after")
    def _consistent(self) -> ExperimentDesignBlock:
        if not isinstance(self.duration, DurationBlock) and self.duration <= 0:
            raise ValueError("`duration` must be positive")
        for name, family in self.families.items():
            if self.amplitude and not isinstance({**self.vary, **family}.get(self.amplitude), SpanBlock):
                raise ValueError(f"family {name} gives no range of {self.amplitude}, which `amplitude` names")
        return self

    def study(self, base: Path) -> DesignStudy:
        """The study as plain values; `base` is the folder of its file.

        Raises:
            ScenarioError: a file is none, or a name is not in it.
            IdentificationError: the result is none of this calibration.
        """
        calibration = self._calibration(base)
        if calibration.by:
            named = next(iter(calibration.by))
            fix = "give the calibration's study one value for all there"
            raise ScenarioError(self.calibration, f"tells {named} apart by recordings, which a design has none of", fix)
        free = [parameter.name for parameter in calibration.parameters.free]
        sought, duration = (None, self.duration) if isinstance(self.duration, Fraction) else self.duration.longest()
        asked = {
            "parameters": self.parameters,
            "values": self.values,
            "duration.half_width": sought.each if sought else (),
        }
        for place, names in asked.items():
            there = calibration.parameters.names if place == "values" else free
            if unknown := next((name for name in names if name not in there), None):
                raise ScenarioError(
                    f"{place}.{unknown}", "is no parameter of the calibration", f"there are {', '.join(there)}"
                )
        if unknown := next((name for name in self.noise if name not in calibration.outputs), None):
            raise ScenarioError(
                f"noise.{unknown}", "is no output of the calibration", f"there are {', '.join(calibration.outputs)}"
            )
        estimates = self._estimates(base) | self.values
        parameters = ParameterSet(
            tuple(replace(p, start=estimates.get(p.name, p.start)) for p in calibration.parameters.parameters),
            calibration.parameters.ties,
        )
        known = _of_priors(parameters) if self.result is None else _known(base / self.result, parameters)
        return DesignStudy(
            title=self.title,
            calibration=replace(calibration, parameters=_without_priors(parameters)),
            values=parameters.values(np.zeros(len(parameters.free))),
            known=known,
            rig=load_scenario(base / self.scenario, references=False),
            rig_file=base / self.scenario,
            calibration_file=base / self.calibration,
            families={
                name: {key: one.choice() for key, one in family.items()} for name, family in self.families.items()
            },
            limits={name: block.limit() for name, block in self.limits.items()},
            count=self.experiments,
            duration=duration,
            sought=sought,
            criterion=self.criterion,
            parameters=tuple(self.parameters or free),
            vary={name: block.choice() for name, block in self.vary.items()},
            amplitude=self.amplitude,
            noise=dict(self.noise),
            compare={name: tuple(cases) for name, cases in self.compare.items()},
            names=self.name,
            search=SearchSpec(**dict(self.search)),
            description=self.description,
        )

    def _calibration(self, base: Path) -> OutputErrorStudy:
        file = base / self.calibration
        block = load(file, OutputErrorBlock)
        asked = block.complete(file.parent)
        return asked.study(asked.system(file.parent), asked.source(file.parent))

    def _estimates(self, base: Path) -> dict[str, float]:
        if self.result is None:
            return {}
        return {name: entry["value"] for name, entry in read_summary(base / self.result)["parameters"].items()}


def _known(folder: Path, parameters: ParameterSet) -> FloatArray:
    """(n, n) the information behind the covariance in a result's summary, in z; 0 of what it does not determine."""
    found = covariance_in(folder)
    if found is None:
        raise IdentificationError(folder, "has no covariance", "give the result of an output-error study")
    names, matrix = found
    free = [parameter.name for parameter in parameters.free]
    slopes = dict(zip(free, parameters.slopes(np.zeros(len(free))), strict=True))
    rows = [i for i, name in enumerate(names) if name in slopes and np.isfinite(matrix[i, i])]
    size = np.array([slopes[names[i]] for i in rows])
    places = [free.index(names[i]) for i in rows]
    information = np.zeros((len(free), len(free)))
    if rows:
        relative = matrix[np.ix_(rows, rows)] / np.outer(size, size)
        information[np.ix_(places, places)] = np.linalg.pinv(relative, hermitian=True)
    return information


def _without_priors(parameters: ParameterSet) -> ParameterSet:
    """The same for recordings alone: what is known before is counted once, beside them."""
    return replace(parameters, parameters=tuple(replace(one, prior=None) for one in parameters.parameters))


def _of_priors(parameters: ParameterSet) -> FloatArray | None:
    """(n, n) the information of what the calibration's study says of parameters before, in z; None without any."""
    slopes = parameters.slopes(np.zeros(len(parameters.free)))
    weights = [
        0.0 if parameter.prior is None else (parameter.prior.slope(parameter.start) * slope) ** 2
        for parameter, slope in zip(parameters.free, slopes, strict=True)
    ]
    return np.diag(weights) if any(weights) else None
