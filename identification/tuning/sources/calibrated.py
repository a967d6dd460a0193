"""The system that an output-error calibration has left in its folder, with the spread of its estimates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError
from identification.output_error.schema import OutputErrorBlock
from identification.results import STUDY, covariance_in, read_summary, result_file
from identification.tuning.sources.system_plant import ParameterSpread
from orchestrator.assembly.assembly import SystemSpec
from orchestrator.yaml_file import load


def calibrated_system(folder: Path) -> tuple[SystemSpec, ParameterSpread]:
    """The system of the study in a result folder with its estimates, and their covariance.

    Raises:
        InputError: the folder holds no result of an output-error study.
    """
    summary = read_summary(folder)
    if summary["method"] != "output-error":
        problem = f"holds a result of the method {summary['method']}, which has no components"
        raise IdentificationError(folder, problem, "leave `inputs` and `outputs` out")
    block = load(result_file(folder, STUDY), OutputErrorBlock)
    values = {name: entry["value"] for name, entry in summary["parameters"].items() if "." in name}
    return block.system(folder).given(values), _spread(folder)


def estimates(folder: Path, wanted: Sequence[str] | None) -> tuple[dict[str, float], ParameterSpread]:
    """What an output-error calibration has found of these parameters, by default of all, and their covariance.

    Raises:
        InputError: the folder holds no result of such a study, or no covariance of one of them.
    """
    summary, spread = read_summary(folder), _spread(folder)
    names = spread.names if wanted is None else tuple(wanted)
    missing = next((name for name in names if name not in spread.names), None)
    if missing is not None or not names:
        problem = f"has no covariance of {missing or 'any parameter'}"
        raise IdentificationError(folder, problem, f"there are {', '.join(spread.names) or 'none'}")
    rows = [spread.names.index(name) for name in names]
    values = {name: summary["parameters"][name]["value"] for name in names}
    return values, ParameterSpread(names, spread.covariance[np.ix_(rows, rows)])


def _spread(folder: Path) -> ParameterSpread:
    """Of the parameters; delays, which are no component's, are left out. Empty where the result has no covariance."""
    found = covariance_in(folder)
    if found is None:
        return ParameterSpread()
    names, matrix = found
    kept = [i for i, name in enumerate(names) if "." in name]
    return ParameterSpread(tuple(names[i] for i in kept), matrix[np.ix_(kept, kept)])
