"""The observability range space, extracted from records: what every subspace method shares.

All methods take the singular vectors of a projection of future outputs, which follows from one triangular factor of the
data; `weightings` says what each projects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.linear.hankel import Compression, HankelFactor, factor
from identification.linear.poles import Poles
from identification.linear.records import InputOutputData, RecordPieces, Records, checked_weights, without_gaps
from identification.subspace.weightings import WEIGHTINGS, Blocks, Weighting, blocks, predicted
from orchestrator.trace import FloatArray

Instruments = Literal["inputs and outputs", "inputs"]
_RANK = 1e-10


@dataclass(frozen=True)
class SubspaceSettings:
    """How a model is estimated.

    Attributes:
        block: q, block rows of the future; more than the order over the number of outputs.
        weighting: "orse" as published; "n4sid", "moesp" and "cva" project on the past, which keeps noise out.
        past: block rows of the past, or of the autoregression in closed loop; `block` without. ORSE has none.
        instruments: what of the past is projected on; "inputs" alone stays consistent under any output noise.
        closed_loop: whether records are from a closed loop: they are then whitened with a long autoregression first, as
            feedback from noise to input would bias A, B, C, D.
        feedthrough: estimate D, instead of fixing it to 0. In closed loop only right when the controller answers a
            sample later.
        initial_states: whether each record's state at its start is estimated; else all start at 0.
        poles: "stable" moves unstable poles inside, "integrating" also puts a real one on 1; B, D are fitted after.
        weights: (p,) one over each output's unit of error, in all least squares; equal ones when empty.
        compression: see `hankel.factor`.
    """

    block: int
    weighting: Weighting = "orse"
    past: int | None = None
    instruments: Instruments = "inputs and outputs"
    closed_loop: bool = False
    feedthrough: bool = False
    initial_states: bool = True
    poles: Poles = "free"
    weights: tuple[float, ...] = ()
    compression: Compression = "auto"

    def __post_init__(self) -> None:
        if self.block < 2:
            raise IdentificationError("settings", f"block is {self.block}", "use at least 2")
        if self.past is not None and self.past < 1:
            raise IdentificationError("settings", f"past is {self.past}", "use at least 1")
        if self.closed_loop and self.history < self.block:
            raise IdentificationError(
                "settings",
                f"past {self.history} is below block {self.block}",
                "in closed loop use a past at least as long",
            )

    @property
    def history(self) -> int:
        """Block rows of the past."""
        if self.weighting == "orse" and not self.closed_loop:
            return 0
        return self.block if self.past is None else self.past


@dataclass(frozen=True, eq=False)
class RangeSpace:
    """The range space of the observability matrix, for every order at once.

    Attributes:
        basis: (q p, r) columns in falling importance; the first n span the range space of order n.
        values: (r,) singular values of the weighted projection; the published ones (Eq. 2-21) are their squares.
        pieces: the records without gaps.
        weights: (p,) by which outputs were multiplied.
        settings: how it was extracted.
        condition: of the compressed data, see `hankel.Factor`.
        compression: how the data were compressed.
        excitation: condition of the input's block Hankel matrix.
    """

    basis: FloatArray
    values: FloatArray
    pieces: RecordPieces
    weights: FloatArray
    settings: SubspaceSettings
    condition: float
    compression: Compression
    excitation: float

    @property
    def limit(self) -> int:
        """The most states that shift invariance can determine."""
        return (self.settings.block - 1) * len(self.weights)

    def shift_invariant(self, order: int) -> tuple[FloatArray, FloatArray]:
        """A (n, n) and C (p, n) of the basis' first n columns (ORSE, steps 3 and 4)."""
        outputs, observability = len(self.weights), self.basis[:, :order]
        a = np.linalg.lstsq(observability[:-outputs], observability[outputs:], rcond=None)[0]
        return np.asarray(a), observability[:outputs]


@single_threaded
def range_space(records: Records, settings: SubspaceSettings) -> RangeSpace:
    """The observability range space of all records together.

    Raises:
        IdentificationError: records that do not fit together or are too short, an output that never changes, inputs
            that do not excite, weights that do not fit.

    Source: the flexible-manipulator thesis, Eqs. 2-18 to 2-21; Van Overschee and De Moor 1996, Chapter 4, for the
    weights; Chiuso 2007 (PBSID-opt) in closed loop.
    """
    depth = settings.history + (1 if settings.closed_loop else settings.block)
    pieces = without_gaps(records, depth)
    first = pieces.records[0]
    _check_outputs(pieces)
    weights = checked_weights(settings.weights or [1.0] * len(first.outputs), first.outputs)
    signals = [np.hstack([record.u, record.y * weights]) for record in pieces.records]
    rows = _blocks(settings, len(first.inputs), len(first.outputs))
    _check_length(pieces, depth, rows.count)
    compressed = factor(signals, rows.groups, settings.compression)
    excitation = _excitation(compressed, rows, first)
    basis, values = (
        predicted(compressed.lower, rows, settings.block, settings.weighting)
        if settings.closed_loop
        else WEIGHTINGS[settings.weighting](compressed.lower, rows)
    )
    return RangeSpace(
        basis, values, pieces, weights, settings, compressed.condition, compressed.compression, excitation
    )


def _blocks(settings: SubspaceSettings, inputs: int, outputs: int) -> Blocks:
    past, block = settings.history, settings.block
    if settings.closed_loop:
        return blocks(inputs, outputs, past, seen=past, given=int(settings.feedthrough), asked=1)
    seen = past if settings.instruments == "inputs and outputs" else 0
    return blocks(inputs, outputs, past, seen=seen, given=block, asked=block)


def _check_outputs(pieces: RecordPieces) -> None:
    for i, name in enumerate(pieces.records[0].outputs):
        if all(np.ptp(record.y[:, i]) == 0 for record in pieces.records):
            raise IdentificationError(f"{pieces.records[0].name}.{name}", "is constant", "leave this output out")


def _check_length(pieces: RecordPieces, depth: int, rows: int) -> None:
    columns = pieces.samples - len(pieces.records) * (depth - 1)
    if columns < rows:
        raise IdentificationError(
            pieces.records[0].name,
            f"{pieces.samples} samples give {columns} columns for the {rows} rows of the block Hankel matrix",
            "use a smaller block",
        )


def _excitation(compressed: HankelFactor, rows: Blocks, first: InputOutputData) -> float:
    """Condition of the inputs' block Hankel matrix, each row scaled to length 1."""
    lead = compressed.lower[: rows.inputs, : rows.inputs]
    lengths = np.linalg.norm(lead, axis=1, keepdims=True)
    values = np.linalg.svd(lead / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    rank = int(np.count_nonzero(values > _RANK * values[0])) if values[0] > 0 else 0
    if rank < rows.inputs:
        raise IdentificationError(
            f"{first.name}.{', '.join(first.inputs)}",
            f"does not excite enough: its block Hankel matrix has rank {rank}, {rows.inputs} is needed",
            "use a smaller block, or an input with more frequencies",
        )
    return float(values[0] / values[-1])
