"""Information criteria of models that were fitted to the same recordings: how well they fit, for how much freedom.

The noise of each output is taken for Gaussian, of a size that each model estimates anew; how it is spread over windows
is what the study's weights say. Correlated samples count by how many tell as much as one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.trace import FloatArray, ReadOnlyArrays

_LEAST = 1e-12  # of an output's power, below which the accuracy of a simulation lies


@dataclass(frozen=True, eq=False)
class Misfit(ReadOnlyArrays):
    """What a model leaves over of m outputs, where it was fitted.

    Attributes:
        power: (m,) mean square of what is left over, as weights and loss count it, over that of what was recorded.
        samples: (m,) of each.
        samples_each: (m,) how many of them tell as much as one of white noise.
        unknowns: parameters that were fitted, start values of windows included.
    """

    power: FloatArray
    samples: FloatArray
    samples_each: FloatArray
    unknowns: int


@dataclass(frozen=True)
class Criteria:
    """Of one model: less is better, and only differences mean something.

    Attributes:
        aicc: Akaike's, corrected for few samples; infinite where there are hardly more than unknowns.
        bic: Schwarz's.
        samples: independent ones that they count with.
    """

    aicc: float
    bic: float
    samples: float


def criteria(misfits: Mapping[str, Misfit]) -> dict[str, Criteria]:
    """The criteria of each model; correlation of the noise is that of the one that leaves least over.

    -2 ln L = sum over outputs of n ln(power); AICc = -2 ln L + 2 k + 2 k (k + 1) / (n - k - 1);
    BIC = -2 ln L + k ln n, with k unknowns and a noise of each output.

    Source: Burnham and Anderson 2002, Sections 2.4 and 6.4; Schwarz 1978.
    """
    least = min(misfits.values(), key=lambda one: float(np.sum(one.samples * _logarithms(one))))
    counted = least.samples / np.maximum(least.samples_each, 1.0)
    return {name: _criteria(one, counted) for name, one in misfits.items()}


def _logarithms(misfit: Misfit) -> FloatArray:
    return np.asarray(np.log(np.maximum(misfit.power, _LEAST)))


def _criteria(misfit: Misfit, counted: FloatArray) -> Criteria:
    k, n = misfit.unknowns + len(counted), float(np.sum(counted))
    misfitting = float(np.sum(counted * _logarithms(misfit)))
    room = n - k - 1
    corrected = 2 * k + 2 * k * (k + 1) / room if room > 0 else np.inf
    return Criteria(float(misfitting + corrected), float(misfitting + k * np.log(n)), n)
