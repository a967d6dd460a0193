"""Output-error calibration of a system of FMUs, from a study file to estimates and their validation."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError, TraceError
from identification.built_system import BuiltSystem
from identification.output_error.estimator import (
    Estimate,
    InitialState,
    Loss,
    Options,
    Parameter,
    ParameterSet,
    Problem,
    SearchState,
    Tie,
    Watch,
    Window,
    estimate,
    predict,
    spread_weights,
)
from identification.output_error.schema import OutputErrorBlock, ParameterBlock, WindowsBlock
from identification.output_error.simulator import SystemFactory
from identification.output_error.windows import Cut, cut_windows
from identification.recordings.campaign import Recorded, load_campaign, recording_warnings, split
from orchestrator.assembly.assembly import Assembled, OpenSystem
from orchestrator.progress import Progress, silent
from orchestrator.system import Endpoint, check_values, must_be
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Judged:
    """Free runs over some windows.

    Attributes:
        simulated: (K, m) a window.
        fit: (W, m) FIT of each window and output.
        outputs: component.variable of the m outputs.
    """

    outputs: tuple[str, ...]
    cuts: tuple[Cut, ...]
    simulated: tuple[FloatArray, ...]
    fit: FloatArray

    @property
    def median(self) -> float:
        """Median FIT over all windows and outputs; nan where none of them moves."""
        return _median(self.fit)

    def by_trace(self) -> dict[str, float]:
        """trace -> median FIT of its windows."""
        return {name: _median(fit) for name, fit in self._traces().items()}

    def by_output(self) -> dict[str, float]:
        """output -> median FIT over all windows."""
        return self._outputs(self.fit)

    def by_trace_and_output(self) -> dict[str, dict[str, float]]:
        """trace -> output -> median FIT of its windows."""
        return {name: self._outputs(fit) for name, fit in self._traces().items()}

    def _traces(self) -> dict[str, FloatArray]:
        names = dict.fromkeys(cut.trace for cut in self.cuts)
        return {name: self.fit[[cut.trace == name for cut in self.cuts]] for name in names}

    def _outputs(self, fit: FloatArray) -> dict[str, float]:
        return {name: _median(column) for name, column in zip(self.outputs, fit.T, strict=True)}


def _median(fit: FloatArray) -> float:
    known = fit[~np.isnan(fit)]
    return float(np.median(known)) if known.size else math.nan


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a study gave.

    Attributes:
        train, validation: free runs with the estimates; validation is None where no trace was kept aside.
        compared: name -> free runs with the parameters of the study's `compare`, on the validation windows (on the
            fitted ones where there are none).
        system: the FMUs as they were before.
    """

    study: OutputErrorBlock
    system: BuiltSystem
    recorded: tuple[Recorded, ...]
    estimate: Estimate
    train: Judged
    validation: Judged | None
    compared: Mapping[str, Judged]
    units: Mapping[str, str]

    @property
    def warnings(self) -> list[str]:
        """What a reader of the figures must know."""
        return [*self.estimate.warnings, *recording_warnings(self.recorded)]


def processes() -> int:
    """Worker processes to use: one a processor."""
    return os.cpu_count() or 1


def calibrate(
    study: OutputErrorBlock, base: Path, data: Path | None = None, progress: Progress = silent
) -> Calibration:
    """Fit the study's parameters to its traces and judge them on the traces kept aside.

    Args:
        base: folder of the study file.
        data: the recordings, over the study's own.

    Raises:
        InputError: the study, the system or the traces do not fit together; nothing has been simulated.
        FmuError: the FMUs fail with every start, or with the estimates on the traces kept aside.
    """
    recorded = load_campaign(study.traces, base, data, signals=study.signals)
    fitted, kept = split(recorded, study.traces.hold_out)
    system = BuiltSystem(study.system(base), sorted(study.inputs))
    units = _checked_units(study, system.assembled)
    train = cut_windows(study, fitted, study.windows)
    unseen = cut_windows(study, kept, study.validation or study.windows)
    found = _fit(study, system.assembled, train, units, _watch(study, progress))
    validation = _judge(study, system.assembled, unseen, found.values) if unseen else None
    compared = {
        name: _judge(study, system.assembled, unseen or train, {**found.values, **other})
        for name, other in study.compare.items()
    }
    judged = Judged(tuple(study.outputs), tuple(train), found.simulated, found.fit)
    return Calibration(study, system, tuple(recorded), found, judged, validation, compared, units)


def _watch(study: OutputErrorBlock, progress: Progress) -> Watch:
    limit = study.options.max_evaluations

    def watch(at: SearchState) -> None:
        fraction = {"fit": 0.1 + 0.7 * min(at.iteration / limit, 1), "uncertainty": 0.8}.get(at.stage, 0.05)
        progress(fraction, f"{at.stage} {at.iteration}, cost {at.cost:.4g}, {at.simulations} simulations")

    return watch


def judge(
    study: OutputErrorBlock,
    assembled: Assembled,
    recorded: Sequence[Recorded],
    windows: WindowsBlock,
    values: Mapping[str, float],
) -> Judged:
    """Free runs over the windows of these traces, with these values over the study's."""
    return _judge(study, assembled, cut_windows(study, recorded, windows), values)


def _fit(
    study: OutputErrorBlock, assembled: Assembled, cuts: list[Cut], units: Mapping[str, str], watch: Watch
) -> Estimate:
    parameters = _parameters(study, units)
    problem = _problem(study, cuts, parameters, _weights(study, cuts), Loss(study.loss.kind, study.loss.scale))
    factory = SystemFactory(assembled, cuts, tuple(study.outputs), assembled.system.values())
    return estimate(problem, factory, Options(**study.options.model_dump(), processes=processes()), watch)


def _judge(study: OutputErrorBlock, assembled: Assembled, cuts: list[Cut], values: Mapping[str, float]) -> Judged:
    fixed = ParameterSet(tuple(Parameter(name, value, fixed=True) for name, value in values.items()))
    factory = SystemFactory(assembled, cuts, tuple(study.outputs), assembled.system.values())
    found = predict(_problem(study, cuts, fixed, _even_weights(cuts), Loss()), factory, Options(processes=processes()))
    return Judged(tuple(study.outputs), tuple(cuts), found.simulated, found.fit)


def _problem(
    study: OutputErrorBlock, cuts: list[Cut], parameters: ParameterSet, weights: list[FloatArray], loss: Loss
) -> Problem:
    windows = tuple(
        Window(cut.name, cut.trace, cut.measured, weight) for cut, weight in zip(cuts, weights, strict=True)
    )
    states = tuple(
        InitialState(name, tuple(cut.initial[name] for cut in cuts), estimated=block.estimated)
        for name, block in study.initial.items()
    )
    return Problem(parameters, windows, dict.fromkeys(study.outputs, "1"), states, loss)


def _even_weights(cuts: list[Cut]) -> list[FloatArray]:
    """(m,) weights of windows to be judged: by the spread of each output, 1 for one that rests in all of them."""
    spread = np.concatenate([cut.measured for cut in cuts]).std(axis=0)
    return [1 / np.where(spread > 0, spread, 1.0)] * len(cuts)


def _weights(study: OutputErrorBlock, cuts: list[Cut]) -> list[FloatArray]:
    if study.weight == "window":
        return [_window_weight(study, cut) for cut in cuts]
    if study.weight == "output":
        return [spread_weights([cut.measured for cut in cuts])] * len(cuts)
    return [np.ones(len(study.outputs))] * len(cuts)


def _window_weight(study: OutputErrorBlock, cut: Cut) -> FloatArray:
    """(m,) weights by the spread within a window; an output that rests there has none."""
    for name, measured in zip(study.outputs, cut.measured.T, strict=True):
        if np.all(measured == measured[0]):
            raise TraceError(
                cut.name,
                f"{name} does not move there, so `weight: window` means nothing",
                "skip the window, or weight: output",
            )
    return spread_weights([cut.measured])


def _parameters(study: OutputErrorBlock, units: Mapping[str, str]) -> ParameterSet:
    parameters = [
        _parameter(study, name, block, units[name]) for name, block in study.parameters.items() if block.tied is None
    ]
    ties = [Tie(name, block.tied, block.factor) for name, block in study.parameters.items() if block.tied is not None]
    return ParameterSet(tuple(parameters), tuple(ties))


def _parameter(study: OutputErrorBlock, name: str, block: ParameterBlock, unit: str) -> Parameter:
    start = block.start if block.start is not None else study.values().get(name)
    if not isinstance(start, (int, float)) or isinstance(start, bool):
        raise IdentificationError(
            f"parameters.{name}", "has no start value", "give `start`, or set it in its component"
        )
    if not (start or block.fixed) and (block.min is None or block.max is None):
        raise IdentificationError(
            f"parameters.{name}",
            "starts at 0 with an open bound, so its size is not known",
            "give `min` and `max`, or another start",
        )
    low = -np.inf if block.min is None else block.min
    high = np.inf if block.max is None else block.max
    return Parameter(name, float(start), low, high, unit, block.scale, block.fixed)


def _checked_units(study: OutputErrorBlock, assembled: Assembled) -> dict[str, str]:
    """Units of the parameters, once every name of the study is seen to exist."""
    with OpenSystem(assembled) as opened:
        system = opened.system
        check_values(system, study.values())
        for name in study.outputs:
            must_be(system, name, "output", "outputs")
        for key, names in _named_parameters(study).items():
            for name in names:
                must_be(system, name, "parameter", key)
        for name, block in study.parameters.items():
            for value in (block.start, block.min, block.max):
                check_values(system, {} if value is None or name in study.delays else {name: value})
        for values in study.compare.values():
            check_values(system, {name: value for name, value in values.items() if name not in study.delays})
        named = [*study.parameters, *study.outputs, *study.initial]
        units = {name: system.port(Endpoint.parse(name)).unit or "1" for name in named if name not in study.delays}
        return units | dict.fromkeys(study.delays, "s")


def _named_parameters(study: OutputErrorBlock) -> dict[str, list[str]]:
    """Key of the study -> the parameters of components that it names."""
    named: dict[str, Iterable[str]] = {
        "initial": study.initial,
        "traces.values": study.traces.values,
        "parameters": study.parameters,
        "truth": study.truth,
        **{f"compare.{name}": values for name, values in study.compare.items()},
    }
    return {key: [name for name in names if name not in study.delays] for key, names in named.items()}
