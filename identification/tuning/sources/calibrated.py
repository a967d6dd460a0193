"""The system that an output-error calibration has left in its folder, with the spread of its estimates."""

from __future__ import annotations

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


def _spread(folder: Path) -> ParameterSpread:
    """Of the parameters; delays, which are no component's, are left out. Empty where the result has no covariance."""
    found = covariance_in(folder)
    if found is None:
        return ParameterSpread()
    names, matrix = found
    kept = [i for i, name in enumerate(names) if "." in name]
    return ParameterSpread(tuple(names[i] for i in kept), matrix[np.ix_(kept, kept)])
