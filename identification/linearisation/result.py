"""A system's linear model about a point, its modes and signals, and the folder that it is written to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from typing_extensions import TypedDict

from identification.linear.fmu import linear_fmu
from identification.linear.model import LinearModel
from identification.linear.modes import Mode, frequencies
from identification.linear.preparation import Offsets
from identification.linear.summary import ModelSummary, ModeSummary, model_summary, summaries
from identification.results import SUMMARY
from orchestrator.display.table import table
from orchestrator.results import result_folder, versions, write_json

FMU = "linear.fmu"


class LinearisedSummary(TypedDict):
    """What `summary.json` holds; the matrices take `inputs` to `outputs`, both from their zero.

    Attributes:
        time: of the point [s].
        point: the point in words.
        by: component -> what its slopes were found by.
    """

    title: str
    time: float
    point: str
    case: str
    inputs: Sequence[ModelSignal]
    outputs: Sequence[ModelSignal]
    modes: list[ModeSummary]
    model: ModelSummary
    by: dict[str, str]
    versions: dict[str, str]
    warnings: list[str]


@dataclass(frozen=True)
class ModelSignal:
    """An input or output of the model.

    Attributes:
        name: in the model.
        of: component.variable.
        zero: its value at the point, which the model counts from.
    """

    name: str
    of: str
    unit: str
    zero: float


@dataclass(frozen=True, eq=False, repr=False)
class Linearised:
    """A linear model of a system about a point.

    Attributes:
        model: from what drives the system to its outputs, over `model.step`, inputs held; both count from their zero.
        time: of the point [s].
        point: the point in words.
        case: of the scenario that ran.
        by: component -> what its slopes were found by.
        remarks: what a reader must know of it.
    """

    title: str
    model: LinearModel
    inputs: tuple[ModelSignal, ...]
    outputs: tuple[ModelSignal, ...]
    time: float
    point: str
    case: str
    by: Mapping[str, str]
    remarks: tuple[str, ...]

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Frequency and damping of each."""
        return frequencies(self.model.eigenvalues, self.model.step)

    @property
    def units(self) -> dict[str, str]:
        """Of the model's inputs and outputs that have one."""
        return {signal.name: signal.unit for signal in (*self.inputs, *self.outputs) if signal.unit}

    @property
    def zero(self) -> Offsets:
        """What inputs and outputs count from."""
        return Offsets(*(np.array([signal.zero for signal in side]) for side in (self.inputs, self.outputs)))

    @property
    def summary(self) -> LinearisedSummary:
        """All that in plain values."""
        return {
            "title": self.title,
            "time": self.time,
            "point": self.point,
            "case": self.case,
            "inputs": self.inputs,
            "outputs": self.outputs,
            "modes": summaries(self.modes),
            "model": model_summary(self.model),
            "by": dict(self.by),
            "versions": versions(),
            "warnings": list(self.remarks),
        }

    def write(self, folder: str | Path) -> Path:
        """Write the model as a `state_space` FMU, and summary.json; the folder comes back.

        Raises:
            InputError: the folder holds something else.
        """
        zero = self.zero
        with result_folder(Path(folder)) as fresh:
            linear_fmu(self.model, fresh / FMU, self.units, zero if np.any(zero.u) or np.any(zero.y) else None)
            write_json(fresh / SUMMARY, self.summary)
        return Path(folder)

    def __repr__(self) -> str:
        return f"<Linearised '{self.title}' at {self.time:g} s: {self.model!r}>"

    def _repr_html_(self) -> str:
        rows = [(one["mode"], one["frequency"], one["damping"]) for one in summaries(self.modes)]
        return table(("mode", "frequency [Hz]", "damping"), rows, caption=self.title)
