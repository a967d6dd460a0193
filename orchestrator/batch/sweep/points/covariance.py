"""What a calibration has found, as factors that are drawn together: its `summary.json` holds values and covariance."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fmus.errors import ScenarioError
from fmus.files import RawMap
from orchestrator.batch.sweep.points.factors import Factor, JointFactors, TruncatedNormal
from orchestrator.batch.sweep.points.resolving import FactorPlace
from orchestrator.batch.sweep.points.schema import CalibrationBlock
from orchestrator.trace import FloatArray

SUMMARY = "summary.json"


def drawn_together(block: CalibrationBlock, place: FactorPlace) -> tuple[list[Factor], JointFactors]:
    """The parameters of a calibration in the units of the scenario's variables.

    Raises:
        ScenarioError: the folder holds no calibration with a covariance, or one of the parameters is not determined.
        ServotwinError: a parameter is nothing that the scenario has.
    """
    folder = place.file.parent / block.folder
    document = _document(folder)
    names, matrix = _covariance(folder, document)
    chosen = block.parameters or [name for name in names if "." in name]
    if missing := next((name for name in chosen if name not in names), None):
        raise ScenarioError(folder, f"has no covariance of {missing}", f"there are {', '.join(names)}")
    rows = [names.index(name) for name in chosen]
    wanted = matrix[np.ix_(rows, rows)]
    if not np.isfinite(wanted).all():
        lost = next(name for name, row in zip(chosen, wanted, strict=True) if not np.isfinite(row).all())
        raise ScenarioError(folder, f"has not determined {lost}", "name the others as `parameters`")
    entries = [document["parameters"][name] for name in chosen]
    scales = np.array([_scale(name, one, place) for name, one in zip(chosen, entries, strict=True)])
    mean = scales * np.array([float(one["value"]) for one in entries])
    root = _root(wanted * np.outer(scales, scales))
    spread = np.linalg.norm(root, axis=1)
    units = [place.target(name)[1].unit or "" for name in chosen]
    factors = [
        Factor(name, TruncatedNormal(float(middle), float(std)), unit=unit)
        for name, middle, std, unit in zip(chosen, mean, spread, units, strict=True)
    ]
    return factors, JointFactors(tuple(chosen), mean, root)


def _document(folder: Path) -> RawMap:
    file = folder / SUMMARY
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError:
        raise ScenarioError(file, "is not there", "give the folder of a calibration") from None
    except (ValueError, RecursionError) as error:
        raise ScenarioError(file, f"is not JSON ({error})", "calibrate again") from None
    if not isinstance(document, dict) or not isinstance(document.get("parameters"), dict):
        raise ScenarioError(file, "holds no parameters", "give the folder of a calibration")
    return document


def _covariance(folder: Path, document: RawMap) -> tuple[list[str], FloatArray]:
    """Names (n,) and their covariance (n, n), NaN where it is not known."""
    try:
        found = document["uncertainty"]["covariance"]
        names = [str(name) for name in found["parameters"]]
        matrix = np.array([[np.nan if one is None else float(one) for one in row] for row in found["matrix"]])
        return names, matrix.reshape(len(names), len(names))
    except (KeyError, TypeError, ValueError):
        method = document.get("method", "another")
        problem = f"holds no covariance, which the method output-error tells (this is {method})"
        raise ScenarioError(folder, problem, "calibrate so, or give each parameter `normal` and `std`") from None


def _scale(name: str, entry: RawMap, place: FactorPlace) -> float:
    """By what a value in the calibration's unit becomes one in the variable's."""
    _, port = place.target(name)
    unit = str(entry.get("unit", "1"))
    return 1.0 if unit in ("1", "", port.unit) else port.quantity(name, f"1 {unit}", difference=True)


def _root(covariance: FloatArray) -> FloatArray:
    """R with R R' = the covariance, also where that is singular."""
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    found: FloatArray = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return found
