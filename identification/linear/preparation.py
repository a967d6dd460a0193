"""What is done to records before a linear model is fitted to them: bias, mean, filter, scale, friction compensation.

The flexible-manipulator thesis, Section 2.5, item 3. As published only the outputs are filtered, which puts the lag of
a causal filter into the model; here inputs are filtered alike unless told not to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData, between_gaps
from identification.signals.processing import low_pass
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Offsets(ReadOnlyArrays):
    """Where a linear model has its zero: u (m,) of the inputs and y (p,) of the outputs."""

    u: FloatArray
    y: FloatArray


def offsets_of(records: Sequence[InputOutputData]) -> Offsets:
    """The means over all records, gaps left out."""
    u, y = (np.concatenate([getattr(record, name) for record in records]) for name in "uy")
    known = np.isfinite(np.hstack([u, y])).all(axis=1)
    return Offsets(u[known].mean(axis=0), y[known].mean(axis=0))


@dataclass(frozen=True)
class Preparation:
    """Steps that are taken, in this order.

    Attributes:
        zero_mean: names of the outputs that are centred, such as strains; the others start at zero, or where there are
            offsets have these taken off.
        cutoff: corner of a second-order Butterworth low-pass [Hz]; nothing is filtered without.
        causal: whether it filters forwards alone, as an instrument would; else to and fro, without a lag.
        filter_input: whether inputs are filtered as outputs are.
        scaled: whether to bring each output's greatest magnitude in all records to that of the first input.
        offsets: taken off inputs and outputs; None takes nothing off inputs.
    """

    zero_mean: tuple[str, ...] = ()
    cutoff: float | None = None
    causal: bool = False
    filter_input: bool = True
    scaled: bool = True
    offsets: Offsets | None = None


@dataclass(frozen=True, eq=False)
class PreparedData:
    """Records fit for identification.

    Attributes:
        records: without gaps; the pieces of one that has some are named by where they begin.
        scale: (p,) by which the outputs were multiplied.
    """

    records: tuple[InputOutputData, ...]
    scale: FloatArray

    def unscaled(self, model: LinearModel) -> LinearModel:
        """A model of these records in the outputs' own units."""
        return replace(model, c=model.c / self.scale[:, None], d=model.d / self.scale[:, None])


def prepared(records: Sequence[InputOutputData], how: Preparation) -> PreparedData:
    """The records after the steps of `how`, one scale for all of them.

    Raises:
        IdentificationError: an output or the first input is 0 throughout, so that outputs cannot be scaled, or the
            filter does not fit.
    """
    plain = [_filtered(piece, how) for record in records for piece in between_gaps(_centred(record, how))]
    if not plain:
        raise IdentificationError(records[0].name, "holds nothing but gaps", "leave less out")
    scale = _scale(plain) if how.scaled else np.ones(plain[0].y.shape[1])
    return PreparedData(tuple(replace(record, y=record.y * scale) for record in plain), scale)


def without_compensation(u: FloatArray, magnitude: float) -> FloatArray:
    """The command (K, ...) less the magnitude that was added in its direction against Coulomb friction.

    Within the magnitude nothing is left. A model of what remains does not hold the friction (type II of the thesis);
    one of the whole command does (type III).
    """
    return np.sign(u) * np.maximum(np.abs(u) - magnitude, 0.0)


def _centred(record: InputOutputData, how: Preparation) -> InputOutputData:
    centred = np.isin(record.outputs, how.zero_mean)
    known = record.y[np.isfinite(record.y).all(axis=1)]
    if not len(known):
        return record
    zero = known[0] if how.offsets is None else how.offsets.y
    u = record.u if how.offsets is None else record.u - how.offsets.u
    return replace(record, u=u, y=record.y - np.where(centred, known.mean(axis=0), zero))


def _filtered(record: InputOutputData, how: Preparation) -> InputOutputData:
    if how.cutoff is None:
        return record
    y = low_pass(record.y, record.step, how.cutoff, causal=how.causal)
    u = low_pass(record.u, record.step, how.cutoff, causal=how.causal) if how.filter_input else record.u
    return replace(record, u=u, y=y)


def _scale(records: Sequence[InputOutputData]) -> FloatArray:
    largest = np.max([np.abs(record.y).max(axis=0) for record in records], axis=0)
    for number, size in enumerate(largest):
        if not size > 0:
            raise IdentificationError(f"output {number}", "is 0 throughout and cannot be scaled", "leave it out")
    driven = max(float(np.abs(record.u[:, 0]).max()) for record in records)
    if not driven > 0:
        place, fix = f"{records[0].name}.{records[0].inputs[0]}", "record it moving, or leave this input out"
        raise IdentificationError(place, "never moves, so that outputs cannot be scaled by it", fix)
    return np.asarray(driven / largest)
