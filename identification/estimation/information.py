"""Which samples inform which parameter: the share that each has in what is known of it.

The estimate answers an error e of the outputs by A e, with A the pseudo-inverse of the Jacobian; under white noise the
squares of a row of A are, sample by sample, the parts that a parameter's variance is made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimation.arrow_least_squares import WindowBlock
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Information(ReadOnlyArrays):
    """Shares that add up to 1 for each parameter over all windows, instants and outputs; nan for one that is not seen.

    Attributes:
        over_time: (K, n) by instant of a window, all windows together; the longest window's instants.
        by_window: (W, n).
        by_output: (m, n).
    """

    over_time: FloatArray
    by_window: FloatArray
    by_output: FloatArray


def information(blocks: Sequence[WindowBlock], curvature: FloatArray, outputs: int) -> Information:
    """What each sample has told.

    Args:
        curvature: (n, n) inverse of the curvature by the parameters, the states fitted.
        outputs: how many there are; rows of a block are ordered instant by instant.
    """
    weights = [_weights(block, curvature) for block in blocks]
    parts = [one.reshape(len(one) // outputs, outputs, len(curvature)) for one in weights]
    longest = max(map(len, parts))
    over_time = sum(np.pad(part.sum(axis=1), ((0, longest - len(part)), (0, 0))) for part in parts)
    whole = np.sum(over_time, axis=0)
    whole = np.where(whole > 0, whole, np.nan)
    return Information(
        over_time / whole,
        np.array([part.sum(axis=(0, 1)) for part in parts]) / whole,
        np.sum([part.sum(axis=0) for part in parts], axis=0) / whole,
    )


def _weights(block: WindowBlock, curvature: FloatArray) -> FloatArray:
    """(N, n) squares of how the estimates answer to each of a window's residuals."""
    seen = block.parameters
    if block.states.any():
        seen = seen - block.states @ np.linalg.lstsq(block.states, seen, rcond=1e-10)[0]
    return np.asarray((seen @ curvature) ** 2)
