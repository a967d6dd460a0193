"""The linear model that a subspace study has left in its folder, with the spread of its matrices."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.results import SUMMARY, read_summary
from identification.subspace import spread
from identification.tuning.sources.plants import FmuPlant, LinearPlant


@dataclass(frozen=True)
class CalibratedPlant:
    """The model in a result folder."""

    folder: Path

    @property
    def uncertain(self) -> bool:
        """Whether the study has told how uncertain the model is, as it does of a refined one."""
        return bool(self._changes())

    def linear(self, place: str, step: float) -> LinearPlant:
        """The model in the folder's only FMU.

        Raises:
            InputError: the folder holds no result.
            IdentificationError: the result is no linear model.
        """
        read_summary(self.folder)
        fmus = sorted((self.folder / "fmus").glob("*.fmu"))
        if len(fmus) != 1:
            problem = f"{self.folder} holds {len(fmus)} FMUs, not the one of a linear model"
            raise IdentificationError(place, problem, "name the FMU by `fmu`")
        return FmuPlant(fmus[0]).linear(place, step)

    def drawn(self, place: str, step: float, count: int, rng: np.random.Generator) -> list[LinearModel]:
        """Models with the spread of the estimate, to first order.

        Raises:
            IdentificationError: what the summary says of it does not fit the model.
        """
        model = self.linear(place, step).model
        return spread.drawn(model, [_change(self.folder, model, one) for one in self._changes()], count, rng)

    def _changes(self) -> list[Any]:
        read_summary(self.folder)
        found = json.loads((self.folder / SUMMARY).read_text(encoding="utf-8")).get("changes", [])
        if not isinstance(found, list):
            raise IdentificationError(self.folder, "has `changes` of a model that are no list", "calibrate again")
        return found


def _change(folder: Path, model: LinearModel, given: Any) -> LinearModel:
    """A change of the matrices, as a summary has it."""
    try:
        a, b, c, d = (np.array(given[name], dtype=float) for name in spread.MATRICES)
    except (KeyError, TypeError, ValueError) as error:
        raise IdentificationError(
            folder, f"has `changes` of a model that are none ({error})", "calibrate again"
        ) from None
    for found, own in zip((a, b, c, d), (model.a, model.b, model.c, model.d), strict=True):
        if found.shape != own.shape or not np.isfinite(found).all():
            raise IdentificationError(folder, "has `changes` of another model than its FMU's", "calibrate again")
    return replace(model, a=a, b=b, c=c, d=d)
