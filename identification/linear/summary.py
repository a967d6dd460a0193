"""Linear models as summaries of studies hold them."""

from __future__ import annotations

from collections.abc import Sequence

from typing_extensions import TypedDict

from identification.linear.model import LinearModel
from identification.linear.modes import Mode, labels, modes
from identification.results import finite


class ModeSummary(TypedDict):
    """A mode of a model: label, frequency [Hz], damping ratio."""

    mode: str
    frequency: float | None
    damping: float | None


class ModelSummary(TypedDict):
    """Order, sampling time [s], and the matrices a, b, c and d of a model."""

    order: int
    step: float
    matrices: dict[str, list[list[float]]]


def mode_summaries(model: LinearModel) -> list[ModeSummary]:
    """All modes, in the order of `modes`."""
    return summaries(modes(model))


def summaries(found: Sequence[Mode]) -> list[ModeSummary]:
    """These modes."""
    return [
        {"mode": label, "frequency": finite(mode.frequency), "damping": finite(mode.damping)}
        for label, mode in zip(labels(found), found, strict=True)
    ]


def model_summary(model: LinearModel) -> ModelSummary:
    """The model without its modes."""
    matrices = {name: getattr(model, name).tolist() for name in "abcd"}
    return {"order": model.order, "step": model.step, "matrices": matrices}
