"""One model through Chapter 3 of the flexible-manipulator thesis: ranked, reduced in three ways, and updated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import get_args

from identification.linear.model import LinearModel
from identification.linear.modes import Mode, ReductionMethod, kept, labels, modes, ranked
from identification.linear.poles import stabilised
from identification.linear.records import InputOutputData
from identification.linear.reduction import UpdatedMatrix, reduced, updated
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class Example:
    """A model that is reduced and updated.

    Attributes:
        name: by which claims call it.
        unstable: whether it starts from the best unstable order, which is then forced to be stable.
        order, further: states that are kept, and after a second reduction.
        by: which of the three reductions is updated: `mrm` or `msv` alone, or `mrmc` with known frequencies.
        update: which matrix is computed anew, `input` (B) or `output` (C).
    """

    name: str
    unstable: bool
    order: int
    further: int | None
    by: ReductionMethod
    update: UpdatedMatrix


@dataclass(frozen=True, eq=False)
class ValidationErrors:
    """Delta of each output in the two validations: dmv (p,), and sfv (p,) or None where the loop is unstable."""

    dmv: FloatArray
    sfv: FloatArray | None


Validate = Callable[[LinearModel], ValidationErrors]


@dataclass(frozen=True, eq=False)
class Stage:
    """A model on its way.

    Attributes:
        name: initial, stabilised, mrm, msv, mrmc, updated, or further.
        kept: labels of the modes of the ranked model that it has; all when empty.
        model: in scaled outputs.
    """

    name: str
    kept: tuple[str, ...]
    model: LinearModel
    errors: ValidationErrors


@dataclass(frozen=True, eq=False)
class ModeRanking:
    """The modes of a model with their labels and their ranks by MRM and by MSV."""

    modes: tuple[Mode, ...]
    labels: tuple[str, ...]
    mrm: tuple[int, ...]
    msv: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class ReductionExample:
    """An example and its stages, in the order in which they were made."""

    example: Example
    ranking: ModeRanking
    stages: tuple[Stage, ...]

    @property
    def final(self) -> list[Stage]:
        """The updated models, the smaller one last."""
        return [stage for stage in self.stages if stage.name in ("updated", "further")]


def reduce_and_update(
    model: LinearModel, example: Example, fitted: InputOutputData, flexible: Sequence[float], validate: Validate
) -> ReductionExample:
    """All stages of an example.

    Args:
        model: the identified one, in scaled outputs.
        fitted: the record that it was fitted to, prepared.
        flexible: known frequencies of the flexible modes [Hz].

    Raises:
        IdentificationError: a reduction leaves nothing that can be updated.
    """
    stages = [Stage("initial", (), model, validate(model))]
    if not model.stable:
        model = stabilised(model)
        stages.append(Stage("stabilised", (), model, validate(model)))
    ranking = _ranking(model, fitted.u)
    chosen = {by: kept(by, ranking.modes, fitted.u, example.order, flexible) for by in get_args(ReductionMethod)}
    for by, numbers in chosen.items():
        short = reduced(model, numbers)
        stages.append(Stage(by, _labels(ranking, numbers), short, validate(short)))
    short = updated(reduced(model, chosen[example.by]), [fitted], example.update)
    stages.append(Stage("updated", _labels(ranking, chosen[example.by]), short, validate(short)))
    if example.further is not None and example.further < short.order:
        less = kept("mrm", modes(short), fitted.u, example.further)
        shorter = updated(reduced(short, less), [fitted], example.update)
        which = _labels(ranking, [chosen[example.by][i] for i in less])
        stages.append(Stage("further", which, shorter, validate(shorter)))
    return ReductionExample(example, ranking, tuple(stages))


def _ranking(model: LinearModel, u: FloatArray) -> ModeRanking:
    found = modes(model)
    magnitudes = ranked([mode.response_magnitude(u) for mode in found])
    values = ranked([mode.mode_singular_value(len(u)) for mode in found])
    return ModeRanking(found, tuple(labels(found)), tuple(magnitudes), tuple(values))


def _labels(ranking: ModeRanking, kept: Sequence[int]) -> tuple[str, ...]:
    return tuple(ranking.labels[i] for i in kept)
