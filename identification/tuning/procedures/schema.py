"""How a study names its procedure, with the keys that each takes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from identification.estimation.parameters import Scale
from identification.tuning.procedures.given import GivenProcedure
from identification.tuning.procedures.search import Search
from identification.tuning.procedures.state_feedback import StateFeedback
from identification.tuning.procedures.unknowns import Unknown
from identification.tuning.procedures.weights import Weights
from orchestrator.yaml_file import Block, Quantity

Weight = float | list[float] | list[list[float]] | dict[str, float]


class UnknownBlock(Block):
    """A parameter of the controller that is sought between bounds, in its unit or with their own: `5 V`.

    Attributes:
        min, max: the bounds.
    """

    explained_by = (Unknown,)

    start: float | Quantity | None = None
    min: float | Quantity
    max: float | Quantity
    scale: Scale = Unknown.scale

    def unknown(self) -> Unknown:
        """As a plain value."""
        return Unknown(self.min, self.max, self.start, self.scale)


class SearchBlock(Block):
    """A search within bounds.

    Attributes:
        by: names the procedure.
    """

    explained_by = (Search,)

    by: Literal["search"] = "search"
    unknowns: dict[str, UnknownBlock] = Field(min_length=1)
    starts: list[dict[str, float | Quantity]] = []
    more: int = Field(Search.more, ge=0)
    seed: int = Search.seed
    evaluations: int = Field(Search.evaluations, ge=10)

    @model_validator(mode="after")
    def _known(self) -> SearchBlock:
        for start in self.starts:
            for name in start:
                if name not in self.unknowns:
                    raise ValueError(f"`starts`: '{name}' is none of the unknowns")
        return self

    def procedure(self) -> Search:
        """As a plain value."""
        unknowns = {name: block.unknown() for name, block in self.unknowns.items()}
        return Search(unknowns, tuple(self.starts), self.more, self.seed, self.evaluations)


class WeightsBlock(Block):
    """Weights, each a number for all, a diagonal, a matrix, or signal -> weight; see `weights.Weights`.

    Attributes:
        Q: of the states; by name, of the plant's outputs (for K), or of noise at its inputs (for L).
        R: of the command (for K), or of noise in what is measured (for L), by name the controller's inputs.
    """

    Q: Weight = 1.0
    R: Weight = 1.0

    def weights(self) -> Weights:
        """As a plain value."""
        return Weights(self.Q, self.R)


class ObserverBlock(WeightsBlock):
    """Weights of the observer, and how much faster than the feedback it is at least."""

    explained_by = (StateFeedback,)

    faster: float | None = Field(StateFeedback.faster, gt=0)


class StateFeedbackBlock(Block):
    """State feedback from an observer, for `ilqr` and `lqg`.

    Attributes:
        by: names the procedure.
        weights: of the linear-quadratic regulator, for K.
        observer: of its dual, for L.
        ki: bounds of the integral's gain, which is sought on the study's goals; without them it stays.
    """

    explained_by = (StateFeedback,)

    by: Literal["state-feedback"]
    plant: str | None = StateFeedback.plant
    weights: WeightsBlock = WeightsBlock()
    observer: ObserverBlock = ObserverBlock()
    ki: UnknownBlock | None = None

    def procedure(self) -> StateFeedback:
        """As a plain value."""
        integral = None if self.ki is None else Search({"ki": self.ki.unknown()})
        weights, noise = self.weights.weights(), self.observer.weights()
        return StateFeedback(weights, noise, self.observer.faster, self.plant, integral)


class GivenBlock(Block):
    """The controller as it is given: its goals are judged, nothing is sought.

    Attributes:
        by: names the procedure.
    """

    by: Literal["given"]

    def procedure(self) -> GivenProcedure:
        """As a plain value."""
        return GivenProcedure()


def _by(value: Any) -> str:
    """What a design's block is told by."""
    return str(value.get("by", "search") if isinstance(value, dict) else getattr(value, "by", "search"))


DesignBlock = Annotated[
    Annotated[SearchBlock, Tag("search")]
    | Annotated[StateFeedbackBlock, Tag("state-feedback")]
    | Annotated[GivenBlock, Tag("given")],
    Discriminator(_by),
]
