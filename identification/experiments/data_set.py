"""One data set of a campaign: the samples that count, and what a model of them is held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.experiments.physical_modes import PhysicalMode
from identification.experiments.reduction import Example
from identification.experiments.schema import ExperimentsBlock
from identification.linear.preparation import Preparation, prepared, without_compensation
from identification.linear.records import InputOutputData
from identification.linear.set_point import Feedback
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True, eq=False)
class Following:
    """The rig under its controller: `set_point` (K,) and the `response` (K, p) to it, whose noise is filtered."""

    feedback: Feedback
    set_point: FloatArray
    response: FloatArray


@dataclass(frozen=True, eq=False)
class DataSet:
    """What a process needs to work on one data set.

    Attributes:
        removed: whether the compensation was taken off the input (type II), or left in it (type III).
        data: the samples that count, raw but for the compensation.
        preparation: what is done to them before a model is fitted.
        block: block rows of the data matrices.
        orders: that are tried.
        following: what models have to do under the controller.
        physical: lowest modes of the physical model with this payload.
        examples: that begin with this data set.
        stop: how long an end stop was touched [s].
    """

    code: str
    removed: bool
    data: InputOutputData
    preparation: Preparation
    block: int
    orders: range
    following: Following
    physical: tuple[PhysicalMode, ...]
    examples: tuple[Example, ...]
    stop: float

    @property
    def label(self) -> str:
        """The data set's code, with a `c` where the compensation is left in."""
        return self.code if self.removed else f"{self.code}c"


def data_set(
    study: ExperimentsBlock,
    preparation: Preparation,
    code: str,
    removed: bool,
    traces: Mapping[str, Trace],
    physical: tuple[PhysicalMode, ...],
) -> DataSet:
    """A data set of the study.

    Args:
        traces: recordings of all data sets, by their codes.

    Raises:
        IdentificationError: the recording does not fit its entry in the study.
    """
    known = study.sets[code]
    whole = InputOutputData.of(traces[code], [study.input], study.outputs)
    if abs(whole.step * known.rate - 1) > 1e-3 or len(whole) < known.samples:
        raise IdentificationError(
            f"sets.{code}",
            f"has {len(whole)} samples at {1 / whole.step:g} Hz, {known.samples} at {known.rate:g} Hz are needed",
            "correct the scenario or the study",
        )
    u = without_compensation(whole.u, known.compensation) if removed else whole.u
    return DataSet(
        code,
        removed,
        replace(whole, u=u).rows(0, known.samples),
        preparation,
        study.block,
        range(study.orders[0], study.orders[1] + 1),
        _following(study, preparation, traces[study.feedback.records[known.payload]], known.payload, whole.step),
        physical,
        tuple(block.example for block in study.examples if (block.data, block.removed) == (code, removed)),
        float(np.max(traces[code][study.stop][: known.samples])) if study.stop else 0.0,
    )


def _following(
    study: ExperimentsBlock, preparation: Preparation, trace: Trace, payload: float, step: float
) -> Following:
    """Set-point and response of the recording for this payload, at this step [s]."""
    feedback = study.feedback
    samples = study.sets[feedback.records[payload]].samples
    trace = trace.between(float(trace.time[0]), float(trace.time[samples - 1]))
    grid = trace.time[0] + step * np.arange(int(trace.duration / step + 0.5))
    trace = trace.resampled(grid, hold=[feedback.reference])
    measured = InputOutputData.of(trace, [study.input], study.outputs)
    (response,) = prepared([measured], replace(preparation, scaled=False)).records
    loop = Feedback(feedback.proportional, feedback.derivative, feedback.position, feedback.speed)
    return Following(loop, trace[feedback.reference], response.y)
