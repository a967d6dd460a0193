"""Linear models as FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fmus.models.state_space import matrices
from fmus.packaging import linear
from identification.linear.model import LinearModel
from identification.method import CalibratedFmu


def linear_fmu(model: LinearModel, path: Path, units: Mapping[str, str] | None = None) -> CalibratedFmu:
    """A `state_space` FMU of a model's size, built at this path, and the matrices that go into it."""
    direct = model.d if np.any(model.d) else None
    return CalibratedFmu(linear.build(model, path, units), matrices(model.a, model.b, model.c, direct))
