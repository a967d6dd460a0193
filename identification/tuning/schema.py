"""The study file of a tuning: plants, a controller, how they are wired, what is asked, and how it is found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from fmus.errors import WiringError, within
from identification.linear.model import LinearModel
from identification.recordings.schema import StudyBlock
from identification.tuning.goals.goal import Over, Relative
from identification.tuning.goals.table import MEASURES
from identification.tuning.procedures.schema import DesignBlock
from identification.tuning.rig import Rig
from identification.tuning.sources.calibrated import calibrated_system, estimates
from identification.tuning.sources.calibrated_model import CalibratedPlant
from identification.tuning.sources.plants import FmuPlant, GivenPlant, LinearPlant, PlantSpec
from identification.tuning.sources.system_plant import (
    ParameterSpread,
    PlantOutput,
    SystemPlant,
    beside,
    independent,
    set_over,
)
from identification.tuning.study import DrawSpec, GoalSpec, StepSpec, TuningStudy
from orchestrator.assembly.assembly import SystemSpec, link
from orchestrator.assembly.schema import ComponentBlock
from orchestrator.assembly.whole_arrays import Values, elements
from orchestrator.batch.sweep.points.schema import CalibrationBlock
from orchestrator.scenario import parameter_sets
from orchestrator.yaml_file import Block, Quantity, Seconds


def _arrow(line: str) -> str:
    """A connection as it is written."""
    try:
        link(line)
    except WiringError as error:
        raise ValueError(f"{error.place}: {error.fix}") from error
    return line


Matrix = list[list[float]]
Connection = Annotated[str, AfterValidator(_arrow)]
Target = float | Quantity


class MatricesBlock(Block):
    """A linear model, x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

    Attributes:
        A, B, C, D: the matrices row by row; without D inputs do not act on outputs at once.
        sample_time: from one k to the next [s].
        inputs, outputs: name -> unit, in the order of the columns of B and the rows of C.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix | None = None
    sample_time: Seconds = Field(gt=0)
    inputs: dict[str, str] = Field(min_length=1)
    outputs: dict[str, str] = Field(min_length=1)

    @model_validator(mode="after")
    def _shapes(self) -> MatricesBlock:
        n, m, p = len(self.A), len(self.inputs), len(self.outputs)
        for name, matrix, shape in (
            ("A", self.A, (n, n)),
            ("B", self.B, (n, m)),
            ("C", self.C, (p, n)),
            ("D", self.D, (p, m)),
        ):
            if matrix is not None and (len(matrix) != shape[0] or any(len(row) != shape[1] for row in matrix)):
                raise ValueError(f"`{name}` is not {shape[0]} x {shape[1]}")
        return self

    def plant(self) -> LinearPlant:
        """As a plain value."""
        a, b, c = (np.array(matrix, dtype=float) for matrix in (self.A, self.B, self.C))
        d = np.zeros((len(c), b.shape[1])) if self.D is None else np.array(self.D, dtype=float)
        model = LinearModel(a, b, c, d, float(self.sample_time), tuple(self.inputs), tuple(self.outputs))
        return LinearPlant(model, {**self.inputs, **self.outputs})


class OutputBlock(Block):
    """An output of a plant."""

    explained_by = (PlantOutput,)

    of: str
    factor: float = PlantOutput.factor
    unit: str | None = PlantOutput.unit


class PlantBlock(Block):
    """A plant: a linear model, as an FMU, in matrices or the result folder of its study; or a system.

    Attributes:
        fmu: a file with a linear model, such as `subspace` and `linearise` write.
        matrices: a linear model in discrete time.
        components, connections: a system that is linearised where it rests: models by their equations, FMUs of any
            supplier by Model Exchange.
        parameters: of an `fmu` its values; of a system files with parameter sets (SSV), over its own values.
        calibrated: a result folder, of a linear model or of a system.
        set: component.variable -> value over the system's own.
        inputs: of a system, name -> component.input.
        outputs: of a system, name -> component.output, or by keys.
        spread: component.variable -> standard deviation, over what a calibration tells.
        controller: values that it has around this plant, over its own and what is found: where a schedule stands.
        calibration: of `components`, whose values of its parameters are taken, and their covariance as a spread.
    """

    fmu: Path | None = None
    parameters: Path | list[Path] | Values = {}
    calibrated: Path | None = None
    matrices: MatricesBlock | None = None
    components: dict[str, ComponentBlock] | None = Field(None, min_length=1)
    connections: list[Connection] = []
    set: dict[str, float | Quantity] = {}
    inputs: dict[str, str] = {}
    outputs: dict[str, str | OutputBlock] = {}
    spread: dict[str, float] = {}
    controller: Values = {}
    calibration: CalibrationBlock | None = None

    @model_validator(mode="after")
    def _one_source(self) -> PlantBlock:
        sources = (self.fmu, self.calibrated, self.matrices, self.components)
        if sum(source is not None for source in sources) != 1:
            raise ValueError("give one of `fmu`, `calibrated`, `matrices` and `components`")
        values = isinstance(self.parameters, dict)
        if self.parameters and (self.fmu is None if values else not self.inputs):
            raise ValueError("`parameters` are values of an `fmu`, or parameter sets (SSV) of a system with `inputs`")
        if self.connections and self.components is None:
            raise ValueError("`connections` need `components`")
        if bool(self.inputs) != bool(self.outputs) or (self.components is not None and not self.inputs):
            raise ValueError("a system needs `inputs` and `outputs`")
        if self.inputs and self.components is None and self.calibrated is None:
            raise ValueError("`inputs` and `outputs` belong to `components` or to a `calibrated` system")
        if (self.set or self.spread) and not self.inputs:
            raise ValueError("`set` and `spread` belong to a system with `inputs` and `outputs`")
        if self.calibration is not None and self.components is None:
            raise ValueError("`calibration` belongs to `components`")
        for name, deviation in self.spread.items():
            if deviation <= 0:
                raise ValueError(f"`spread`: {name} has a standard deviation of {deviation:g}")
        return self

    def plant(self, base: Path) -> PlantSpec:
        """As a plain value; its files are relative to `base`."""
        if self.fmu is not None:
            return FmuPlant(base / self.fmu, elements(self.parameters if isinstance(self.parameters, dict) else {}))
        if self.matrices is not None:
            return GivenPlant(self.matrices.plant())
        if not self.inputs:
            return CalibratedPlant(base / (self.calibrated or ""))
        system, spread = self._system(base)
        given = {name: {"of": one} if isinstance(one, str) else dict(one) for name, one in self.outputs.items()}
        outputs = {name: PlantOutput(**keys) for name, keys in given.items()}
        own = independent(self.spread) if self.spread else spread
        if self.calibration is not None:
            found, joint = estimates(base / self.calibration.folder, self.calibration.parameters)
            system, own = system.given(found), beside(own, joint)
        sets = [] if isinstance(self.parameters, dict) else parameter_sets.joined(self.parameters, base)
        system = system.given(elements(parameter_sets.values_of(sets, system.components).values))
        return SystemPlant(set_over(system, self.set), self.inputs, outputs, own)

    def _system(self, base: Path) -> tuple[SystemSpec, ParameterSpread]:
        if self.calibrated is not None:
            return calibrated_system(base / self.calibrated)
        components = {name: block.spec(base) for name, block in (self.components or {}).items()}
        return SystemSpec(components, tuple(map(link, self.connections))), ParameterSpread()


class MeasureBlock(Block):
    """A measure, and of what it is; see `goals.goal.Goal`.

    Attributes:
        measure: its name, one of the table in the guide to tuning.
        relative: what a figure is divided by: `reference`, the height of the move; `peak`, the largest error of the
            response.
        weight: factor of its part in the objective.
        of: a signal, `plant.position`.
        opened: the connection at which the loop is opened.
        disturbed: the plant's input to which a step is added.
    """

    measure: str
    of: str | None = None
    opened: str | None = None
    disturbed: str | None = None
    relative: Relative | None = None
    weight: float = Field(GoalSpec.weight, gt=0)

    @field_validator("measure")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in MEASURES:
            raise ValueError(f"'{value}' is no measure; there are {', '.join(MEASURES)}")
        return value

    @model_validator(mode="after")
    def _fitting(self) -> MeasureBlock:
        needs = MEASURES[self.measure].needs
        taken = {"of": {"signal", "noise"}, "relative": {"signal"}, "disturbed": {"signal"}, "opened": {"opened"}}
        for key, wanted in taken.items():
            if getattr(self, key) is not None and not wanted & needs:
                raise ValueError(f"`{key}` means nothing for '{self.measure}'; remove it")
        return self


class GoalBlock(MeasureBlock):
    """A bound on a measure.

    Attributes:
        at_least, at_most: in the measure's unit, or with their own.
        soft: whether to miss it is only a part of the objective, by `weight`.
    """

    at_least: Target | None = None
    at_most: Target | None = None
    soft: bool = False

    @model_validator(mode="after")
    def _bounded(self) -> GoalBlock:
        if self.at_least is None and self.at_most is None:
            raise ValueError("give `at_least` or `at_most`; what is to be small stands under `minimise`")
        if "weight" in self.model_fields_set and not self.soft:
            raise ValueError("`weight` belongs to a `soft` goal")
        return self

    def spec(self, place: str) -> GoalSpec:
        """As a plain value."""
        kept = (self.of, self.disturbed, self.relative)
        return GoalSpec(
            place, self.measure, self.at_least, self.at_most, self.weight, not self.soft, self.opened, *kept
        )


class TermBlock(MeasureBlock):
    """A part of the objective: a measure, summed over the plants or taken at the worst of them.

    Attributes:
        over: how the figures of all plants become one, `sum` or `worst`.
    """

    over: Over = "sum"

    def spec(self, place: str) -> GoalSpec:
        """As a plain value."""
        kept = (self.of, self.disturbed, self.relative, self.over)
        return GoalSpec(place, self.measure, None, None, self.weight, False, self.opened, *kept)


class ReferenceStepBlock(Block):
    """The steps that responses answer to."""

    explained_by = (StepSpec,)

    height: float = StepSpec.height
    duration: Seconds = Field(StepSpec.duration, gt=0, validate_default=True)
    disturbance: float = StepSpec.disturbance
    band: float = Field(StepSpec.band, gt=0, lt=1)
    limit: float | None = Field(StepSpec.limit, gt=0)

    def spec(self) -> StepSpec:
        """As a plain value."""
        return StepSpec(**{**dict(self), "duration": float(self.duration)})


class DrawsBlock(Block):
    """Draws of plants whose parameters have a spread."""

    explained_by = (DrawSpec,)

    count: int = Field(DrawSpec.count, ge=1, le=100_000)
    seed: int = DrawSpec.seed
    share: float = Field(DrawSpec.share, gt=0, le=1)


class RigBlock(Block):
    """A scenario on which the design is judged.

    Attributes:
        scenario: its file, relative to this one.
        set: component.variable -> value over those of the file.
    """

    explained_by = (Rig,)

    scenario: Path
    component: str = Rig.component
    gains_only: bool = Rig.gains_only
    set: Values = {}

    def rig(self, base: Path) -> Rig:
        """As a plain value."""
        return Rig(base / self.scenario, self.component, self.gains_only, self.set)


def require_wanted(goals: Sequence[GoalBlock], minimise: Sequence[TermBlock]) -> None:
    """See that a study asks for something.

    Raises:
        ValueError: it does not.
    """
    if not (goals or minimise):
        raise ValueError("asks for nothing; give `goals` or `minimise`")


def wanted(goals: Sequence[GoalBlock], minimise: Sequence[TermBlock]) -> tuple[GoalSpec, ...]:
    """What a study asks for, as plain values."""
    held = [goal.spec(f"goals.{number}") for number, goal in enumerate(goals)]
    return (*held, *(term.spec(f"minimise.{number}") for number, term in enumerate(minimise)))


class TuneBlock(StudyBlock):
    """A study that finds the values of a controller for several plants at once.

    Attributes:
        controller: what is tuned, as a component of a scenario; its values are where searches start.
        plants: name -> a plant; all are tuned for at once.
        step: the moves that responses are judged by.
        goals: bounds that the design has to hold, or, `soft`, should.
        minimise: what is to be small besides, summed up by weight.
        connections: between `plant` and `controller`, as in a scenario.
        draws: of plants whose parameters have a spread, by which hard goals have to be held, too.
        design: the procedure and its keys.
        judged_on: scenarios on the nonlinear rig, all of whose expectations the design has to hold.
    """

    explained_by = (TuningStudy,)

    method: Literal["tune"]
    controller: ComponentBlock
    plants: dict[str, PlantBlock] = Field(min_length=1)
    connections: list[Connection] = Field(min_length=1)
    reference: str
    tracked: str
    delay: Seconds = Field(TuningStudy.delay, ge=0, validate_default=True)
    step: ReferenceStepBlock = ReferenceStepBlock()
    draws: DrawsBlock | None = None
    goals: list[GoalBlock] = []
    minimise: list[TermBlock] = []
    design: DesignBlock
    judged_on: list[RigBlock] = []

    @model_validator(mode="after")
    def _asked(self) -> TuneBlock:
        require_wanted(self.goals, self.minimise)
        return self

    def study(self, base: Path) -> TuningStudy:
        """The study as plain values; `base` is the folder of its file."""
        return TuningStudy(
            self.title,
            self.controller.spec(base),
            {name: _plant(name, block, base) for name, block in self.plants.items()},
            tuple(map(link, self.connections)),
            self.reference,
            self.tracked,
            wanted(self.goals, self.minimise),
            self.design.procedure(),
            self.step.spec(),
            float(self.delay),
            DrawSpec(**dict(self.draws)) if self.draws else None,
            self.description,
            tuple(block.rig(base) for block in self.judged_on),
            {name: elements(block.controller) for name, block in self.plants.items() if block.controller},
        )


def _plant(name: str, block: PlantBlock, base: Path) -> PlantSpec:
    with within(f"plants.{name}"):
        return block.plant(base)
