"""What the file of a sweep may say; read once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from fmus.errors import ScenarioError
from orchestrator.scenario.expectations.quantities import Share
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.yaml_file import Block, Quantity, Time, load

Level = int | float | bool | str
Number = float | Quantity
MOST_RUNS = 100_000_000


class FactorBlock(Block):
    """What one thing is at the points of a sweep.

    Attributes:
        levels: its values, one after the other; points that are drawn have each as often.
        between: the ends of an interval, in which it is uniform.
        scale: of the interval; `log` makes its logarithm uniform.
        count: of a grid: how many levels from end to end.
        normal, std: mean and standard deviation of a normal distribution; with `between` what lies outside is cut off.
        files: FMUs that take the place of a component, or recordings that drive an input.
        signal: of the recordings.
    """

    levels: list[Level] | None = Field(None, min_length=1)
    between: tuple[Number, Number] | None = None
    scale: Literal["linear", "log"] = "linear"
    count: int | None = Field(None, ge=2)
    normal: Number | None = None
    std: Number | None = None
    files: list[Path] | None = Field(None, min_length=1)
    signal: str | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kinds = [self.levels, self.files, self.between if self.normal is None else self.normal]
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("give `levels`, `between`, `normal` and `std`, or `files`")
        if (self.normal is None) != (self.std is None):
            raise ValueError("`normal` and `std` go together")
        if self.scale == "log" and (self.between is None or self.normal is not None):
            raise ValueError("`scale: log` goes with `between` alone")
        if self.count is not None and self.between is None:
            raise ValueError("`count` goes with `between`")
        if self.signal is not None and self.files is None:
            raise ValueError("`signal` goes with `files`")
        return self


def _levels(value: object) -> object:
    return {"levels": value} if isinstance(value, list) else value


Factor = Annotated[FactorBlock, BeforeValidator(_levels, json_schema_input_type=FactorBlock | list[Level])]


class GridBlock(Block):
    """All combinations of the levels of what varies; the last one changes fastest.

    Attributes:
        by: the kind.
    """

    by: Literal["grid"]


class ListBlock(Block):
    """Points that are written out.

    Attributes:
        by: the kind.
        points: each as name -> value.
        table: a CSV file, relative to this one: a row a point, a column for each `component.variable`, its unit in
            brackets behind the name.
    """

    by: Literal["list"]
    points: list[dict[str, Level]] | None = Field(None, min_length=1)
    table: Path | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.points is None) == (self.table is None):
            raise ValueError("give `points` or `table`")
        return self


class DrawnBlock(Block):
    """Points that are drawn; with more `samples` the first ones stay what they are.

    Attributes:
        by: `monte-carlo` draws independently; `sobol` takes a scrambled Sobol' sequence.
        samples: how many points.
        seed: that all of them, and the seeds of their noise, come from.
    """

    by: Literal["monte-carlo", "sobol"]
    samples: int = Field(ge=1)
    seed: int = Field(ge=0)


class HypercubeBlock(Block):
    """Latin hypercubes, one after the other.

    Attributes:
        by: the kind.
        samples: how many points.
        strata: points of one hypercube; with more `samples` further ones follow. By default all samples are one, to
            which nothing can be added.
        seed: that all of them, and the seeds of their noise, come from.
    """

    by: Literal["latin-hypercube"]
    samples: int = Field(ge=1)
    strata: int | None = Field(None, ge=1)
    seed: int = Field(ge=0)


class SobolIndicesBlock(Block):
    """Points from which Sobol' indices are estimated (Saltelli 2010).

    Attributes:
        by: the kind.
        samples: base samples, a power of two; each has d + 2 points, 2 d + 2 with `second_order`.
        second_order: whether indices of pairs are wanted.
        seed: that all of them come from.
    """

    by: Literal["sobol-indices"]
    samples: int = Field(ge=2)
    second_order: bool = False
    seed: int = Field(ge=0)


class MorrisBlock(Block):
    """Trajectories of elementary effects (Morris 1991).

    Attributes:
        by: the kind.
        trajectories: how many; each has d + 1 points.
        levels: of the grid that they walk on, an even number.
        seed: that all of them come from.
    """

    by: Literal["morris"]
    trajectories: int = Field(ge=2)
    levels: int = Field(4, ge=2, multiple_of=2)
    seed: int = Field(ge=0)


Design = Annotated[
    GridBlock | ListBlock | DrawnBlock | HypercubeBlock | SobolIndicesBlock | MorrisBlock, Field(discriminator="by")
]


class CalibrationBlock(Block):
    """Values that are drawn together, normally, with the covariance that a calibration has found.

    Attributes:
        folder: the result of `servotwin calibrate`, relative to this file.
        parameters: which of its parameters; all by default.
    """

    folder: Path
    parameters: list[str] | None = Field(None, min_length=1)


class SweepTracesBlock(Block):
    """What of each run's signals is kept in its row.

    Attributes:
        signals: component.variable.
        every: time from one sample that is kept to the next, a multiple of the step [s]; all samples by default.
    """

    signals: list[str] = Field(min_length=1)
    every: Annotated[Time, Field(gt=0)] | None = None


class SweepBlock(Block):
    """A study that runs a scenario at many points.

    Attributes:
        title: what it is, in a line.
        description: more of it.
        sweep: the scenario file, relative to this one.
        cases: of the scenario in which each point is run; all by default.
        vary: component.variable -> what it is from point to point: a parameter, a start value, or an input that a
            stimulus drives; component -> FMU files in its place.
        calibration: values that are drawn from what a calibration has found.
        noise: components whose `seed` is another one at each point, made of the design's seed and the point's number.
        design: how the points are chosen.
        measures: name -> what is asked of each run beside the scenario's expectations, and fails nothing.
        traces: what of the signals is kept.
        at_least: share of the runs that have to pass [1]; the exit code is 1 where fewer do.
    """

    title: str
    description: str = ""
    sweep: Path
    cases: list[str] | None = Field(None, min_length=1)
    vary: dict[str, Factor] = {}
    calibration: CalibrationBlock | None = None
    noise: list[str] = []
    design: Design = GridBlock(by="grid")
    measures: dict[Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")], ExpectationBlock] = {}
    traces: SweepTracesBlock | None = None
    at_least: Annotated[Share, Field(gt=0, le=1)] | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        by = self.design.by
        if by in ("list", "grid") and self.calibration is not None:
            raise ValueError(f"`calibration` is drawn from, which a {by} does not do")
        for name, factor in self.vary.items():
            if by == "list":
                raise ValueError("a list says itself what varies; leave `vary` out")
            if by == "grid" and factor.between is not None and factor.count is None:
                raise ValueError(f"`vary.{name}` needs `count` in a grid")
            if by == "grid" and factor.normal is not None:
                raise ValueError(f"{name} is drawn, which a grid does not do; give `levels` or another `design`")
        if not self.vary and self.calibration is None and by not in ("list", "grid"):
            raise ValueError("nothing varies; give `vary` or `calibration`")
        return self


def load_sweep(file: Path) -> SweepBlock:
    """The study in a file.

    Raises:
        ScenarioError: it does not fit.
    """
    if file.suffix not in (".yaml", ".yml") and file.exists():
        raise ScenarioError(file, "is no study of a sweep", "give a YAML file with the key `sweep`")
    return load(file, SweepBlock)
