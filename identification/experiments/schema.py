"""The study file of a campaign of experiments on one rig: its data sets, what is identified, reduced and claimed.

What a publication printed about its own rig stands beside the settings, so that a report can show both.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from identification.experiments.reduction import Example
from identification.linear.modes import ReductionMethod
from identification.linear.schema import ConditioningBlock
from identification.recordings.schema import StudyBlock
from orchestrator.yaml_file import Block

ControlLoop = Literal["open loop", "bounded", "closed loop"]
ClaimOutcome = Literal["held", "held in part", "not borne out"]
PrintedDeltas = tuple[float, float, float, float, float]


class NamedConditioningBlock(ConditioningBlock):
    """A preparation with a name for reports.

    Attributes:
        name: what reports call it.
    """

    name: str = "preparation"


class FeedbackBlock(Block):
    """The controller under which models follow a set-point (Figure 2-3), and the records they are compared with.

    Attributes:
        proportional, derivative: gains from the measured signals to the input, in their units.
        position, speed: the outputs that it uses.
        reference: signal with the set-point.
        records: payload [kg] -> data set whose set-point and response count for this payload.
    """

    proportional: float
    derivative: float
    position: str
    speed: str
    reference: str
    records: dict[float, str]


class PhysicalBlock(Block):
    """The model that frequencies are compared with.

    Attributes:
        model: name of the model.
        payload: its parameter that takes the payload.
        without: parameters that take friction away, and their values.
        modes: how many of the lowest count.
    """

    model: str
    payload: str
    without: dict[str, float] = {}
    modes: int = Field(3, ge=1)


class PublishedSet(Block):
    """What was printed about a data set: stable orders, the order chosen, and delta of each output and their mean.

    Attributes:
        orders: those that gave stable models, as they were printed.
        order: the one that was chosen.
        delta: errors of the four outputs in validation, and their mean.
    """

    orders: str
    order: int
    delta: PrintedDeltas


class SetBlock(Block):
    """One data set.

    Attributes:
        experiment: what drove it: the excitation alone, one that turns at bounds of the position, or a controller.
        excitation: in words, for tables.
        published: what was printed about it.
        volts: greatest magnitude of the excitation.
        rate: [Hz].
        payload: [kg].
        samples: of the record that count; the first half is fitted.
        compensation: magnitude of the friction compensation in the command [V].
    """

    experiment: ControlLoop
    excitation: str
    volts: float
    rate: float = Field(gt=0)
    payload: float = Field(0.0, ge=0)
    samples: int = Field(ge=100)
    compensation: float = Field(0.0, ge=0)
    published: PublishedSet | None = None


class PublishedStage(Block):
    """Printed delta of a model in the two validations.

    Attributes:
        dmv: of the four outputs, and their mean, of free runs along the record (data matching).
        sfv: likewise under the controller, along the set-point (set-point following).
    """

    dmv: PrintedDeltas | None = None
    sfv: PrintedDeltas | None = None


class PublishedExample(Block):
    """What was printed about a reduction: frequency [Hz], damping, rank by MRM and by MSV of each mode, and errors.

    Attributes:
        model: what it was called.
        modes: frequency [Hz], damping, rank by MRM and rank by MSV of each.
        stages: model on the way -> its errors.
    """

    model: str
    modes: list[tuple[float | None, float | None, int, int]] = []
    stages: dict[str, PublishedStage] = {}


class ExampleBlock(Block):
    """A model that is reduced and updated. Models are named after it.

    Attributes:
        data: the data set.
        published: what was printed about it.
        table: number of the tables that it fills, none when it only counts in the last one.
        removed: whether the compensation is taken off the input first (type II), or left in it (type III).
        listed: whether its updated models stand in the last table.
    """

    explained_by = (Example,)

    name: str
    data: str
    table: str = ""
    removed: bool = True
    unstable: bool = False
    order: int = Field(10, ge=1)
    further: int | None = Field(None, ge=1)
    by: ReductionMethod = "mrmc"
    update: Literal["input", "output"] = "output"
    listed: bool = True
    published: PublishedExample | None = None

    @property
    def example(self) -> Example:
        """What is done with the model."""
        return Example(self.name, self.unstable, self.order, self.further, self.by, self.update)


class InequalityBlock(Block):
    """Every figure (or number) of `less`, times a factor, is below every one of `than`.

    Attributes:
        less, than: figures of this study by name, or numbers.
        times: the factor.
    """

    less: list[str | float] = Field(min_length=1)
    than: list[str | float] = Field(min_length=1)
    times: float = Field(1.0, gt=0)


class ClaimBlock(Block):
    """What was claimed, as inequalities between figures of this study.

    Attributes:
        statement: the claim in words.
        holds: inequalities, all of which make it hold; some of which, hold in part.
        outcome: how the claim is known to come out here; another outcome is a regression.
        reason: why the rig does not bear it out, where it does not.
    """

    statement: str
    holds: list[InequalityBlock] = Field(min_length=1)
    outcome: ClaimOutcome
    reason: str = ""


class ExperimentsBlock(StudyBlock):
    """A study of many data sets of one rig: identified, validated, reduced, updated, and held against claims.

    Attributes:
        input: signal of the records that drives the model.
        outputs: signals that it gives.
        preparation: what is done to the records first.
        compared: order of the models whose frequencies are compared with those that were printed.
        feedback: the controller that models are validated under.
        physical: the model that frequencies are compared with.
        sets: name -> a data set.
        examples: models that are reduced and updated.
        claims: what was claimed.
        scenarios: whose cases are the data sets, by name.
        compare: another preparation, under which everything is done again and claims are tried, too.
        stop: signal that tells how long an end stop was touched.
        block: block rows of the data matrices (q).
        orders: least and greatest order that is tried.
        frequencies: data set -> those [Hz] printed for a model of order `compared`.
        typical: data sets whose models are listed as typical.
    """

    method: Literal["experiments"]
    scenarios: list[Path] = Field(min_length=1)
    input: str
    outputs: list[str] = Field(min_length=1)
    stop: str | None = None
    preparation: NamedConditioningBlock = NamedConditioningBlock()
    compare: NamedConditioningBlock | None = None
    block: int = Field(ge=2)
    orders: tuple[int, int]
    compared: int = Field(ge=1)
    frequencies: dict[str, list[float]] = {}
    feedback: FeedbackBlock
    physical: PhysicalBlock
    sets: dict[str, SetBlock] = Field(min_length=1)
    typical: list[str] = []
    examples: list[ExampleBlock] = []
    claims: list[ClaimBlock] = []

    @model_validator(mode="after")
    def _known(self) -> ExperimentsBlock:
        if not 1 <= self.orders[0] <= self.orders[1]:
            raise ValueError("`orders` is [least, most], from 1 up")
        used = [
            *self.feedback.records.values(),
            *self.frequencies,
            *self.typical,
            *(example.data for example in self.examples),
        ]
        for code in used:
            if code not in self.sets:
                raise ValueError(f"there is no data set '{code}' under `sets`")
        others = self.compare.zero_mean if self.compare else []
        for name in (*self.preparation.zero_mean, *others, self.feedback.position, self.feedback.speed):
            if name not in self.outputs:
                raise ValueError(f"'{name}' is no output")
        for code, data_set in self.sets.items():
            if data_set.payload not in self.feedback.records:
                raise ValueError(f"`feedback.records` has none for the payload of {code}, {data_set.payload:g} kg")
        names = [example.name for example in self.examples]
        if len(set(names)) < len(names) or set(names) & set(self.sets):
            raise ValueError("`examples` need names of their own")
        return self
