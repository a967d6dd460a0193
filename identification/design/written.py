"""What a design leaves: a scenario of its experiments, a playback file of each, the study that calibrates by them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.files import RawMap
from identification.design.design import Design
from identification.output_error.schema import OutputErrorBlock
from orchestrator import formats
from orchestrator.documents.parts import INCLUDE
from orchestrator.rational import written
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.trace import Trace
from orchestrator.yaml_file import joined, text_of

EXPERIMENTS, CALIBRATION = "experiments.yaml", "calibration.yaml"
SEED = 1000  # from which on the channels of the experiments draw noise of their own


def write_files(design: Design, folder: Path, target: Path) -> None:
    """Write them into a folder that becomes `target`, to which their paths are relative."""
    (folder / EXPERIMENTS).write_bytes(text_of(_scenario(design, target)))
    for name, candidate in design.experiments.items():
        formats.write(playback(design, candidate.tried.whole), folder / f"{name}_playback.csv")
    study = _calibration(design, target)
    if study is not None:
        (folder / CALIBRATION).write_bytes(text_of(study))


def playback(design: Design, whole: Trace) -> Trace:
    """What drives the rig in an experiment, by the names that the calibration's recordings have."""
    inputs = {
        name: signal.signal for name, signal in design.study.calibration.run.inputs.items() if name in whole.names
    }
    return whole.select(list(inputs)).renamed(inputs)


def _scenario(design: Design, target: Path) -> RawMap:
    """The rig's scenario with the experiments as its cases, and the limits as what must hold."""
    study = design.study
    document, files = joined(study.rig_file, ScenarioBlock)
    _relocate(files, study.rig_file.parent, target)
    document = {
        key: value for key, value in document.items() if key not in (INCLUDE, "matrix", "expect", "cases", "record")
    }
    document["title"] = study.title
    document["description"] = (
        f"Experiments that `servotwin design` has found; the rig is that of {study.rig_file.name}."
    )
    document["run"] = {**document["run"], "stop": written(study.rig.timing.start + study.duration)}
    document["record"] = list(dict.fromkeys([*study.limits, *study.calibration.run.inputs, *study.calibration.outputs]))
    expected = []
    for name, limit in study.limits.items():
        expected += [{"signal": name, "above": limit.above}] if np.isfinite(limit.above) else []
        expected += [{"signal": name, "below": limit.below}] if np.isfinite(limit.below) else []
    if expected:
        document["expect"] = expected
    document["cases"] = [
        {"name": name, "set": {**candidate.tried.values, **_seeds(design, number)}}
        for number, (name, candidate) in enumerate(design.experiments.items(), 1)
    ]
    return document


def _seeds(design: Design, number: int) -> dict[str, int]:
    """Noise of its own for each experiment, of all channels of the library that have some."""
    return {name: SEED + 100 * number + place for place, name in enumerate(design.channels)}


def _calibration(design: Design, target: Path) -> RawMap | None:
    """The calibration's study for the recordings of the experiments, from what is known; none is held out."""
    study = design.study
    if study.calibration_file is None:
        return None
    document, files = joined(study.calibration_file, OutputErrorBlock)
    _relocate(files, study.calibration_file.parent, target)
    document.pop(INCLUDE, None)
    traces = {key: value for key, value in document["traces"].items() if key not in ("hold_out", "exclude")}
    if "scenario" in traces:
        traces["scenario"] = EXPERIMENTS
    document["traces"] = traces
    for name, value in study.values.items():
        block = document["parameters"].get(name)
        if block is not None and "tied" not in block and not block.get("fixed"):
            block["start"] = value
    return document


def _relocate(files: Sequence[tuple[Any, Any]], base: Path, target: Path) -> None:
    """Let paths that are relative to one folder be relative to another."""
    for container, key in files:
        path = Path(str(container[key]))
        if not path.is_absolute():
            container[key] = os.path.relpath((base / path).resolve(), target.resolve())
