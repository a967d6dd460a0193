"""Frequencies and damping of a physical model around rest, from its own equations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from fmus.library import find
from fmus.modelling.model import Model, start_values
from identification.linearisation.equations import ModelEquations
from identification.linearisation.slopes import Standing
from orchestrator.trace import FloatArray

_STEP = 1e-6


@dataclass(frozen=True)
class PhysicalMode:
    """Natural frequency [Hz] and damping ratio."""

    frequency: float
    damping: float


def physical_modes(model: str, parameters: Mapping[str, float]) -> tuple[PhysicalMode, ...]:
    """The oscillating modes of a model near rest, by rising frequency.

    Args:
        model: name of a model with continuous states.
        parameters: values over the model's own; what is not smooth at rest, such as dry friction, has to be switched
            off by them.

    Raises:
        ModelError: there is no such model.
        IdentificationError: it has no such parameter.
    """
    known = find(model)
    defaults = start_values(known)
    stray = [name for name in parameters if name not in defaults]
    if stray:
        raise IdentificationError(f"{model}.{stray[0]}", "is no parameter", f"there are {', '.join(defaults)}")
    poles = np.linalg.eigvals(_linearised(known, parameters))
    found = [_mode(complex(pole)) for pole in poles if pole.imag > 1e-6]
    return tuple(sorted(found, key=lambda mode: mode.frequency))


def _mode(pole: complex) -> PhysicalMode:
    return PhysicalMode(abs(pole) / (2 * math.pi), -pole.real / abs(pole))


def _linearised(model: Model, parameters: Mapping[str, float]) -> FloatArray:
    """(n, n) slopes of the rates by the continuous states, at rest in the origin."""
    n, origin = len(model.continuous), dict.fromkeys((state.name for state in model.states), 0.0)
    [whole] = ModelEquations(model, parameters, Standing(0.0, origin, {})).differences(_STEP)
    return np.asarray(whole[:n, :n])
