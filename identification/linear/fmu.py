"""Linear models as FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fmus.models.state_space import matrices
from fmus.packaging import linear
from identification.linear.model import LinearModel
from identification.linear.preparation import Offsets
from identification.method import CalibratedFmu


def linear_fmu(
    model: LinearModel, path: Path, units: Mapping[str, str] | None = None, zero: Offsets | None = None
) -> CalibratedFmu:
    """A `state_space` FMU of a model's size, built at this path, and what goes into it: matrices, and where it has its
    zero."""
    direct = model.d if np.any(model.d) else None
    about = None if zero is None else (zero.u.tolist(), zero.y.tolist())
    values = matrices(model.a, model.b, model.c, direct, zero=about)
    return CalibratedFmu(linear.build(model, path, units, zero=about), values)
