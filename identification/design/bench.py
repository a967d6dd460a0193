"""A bench where experiments are tried: the rig's scenario says what would be recorded, the model what that tells.

The rig runs with the parameters as they are known; its recording is cut into windows as the calibration will do it, and
the free runs over these give the information about the parameters, by exact tangents where the FMUs carry them.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from fmus.errors import FmuError, IdentificationError, ScenarioError
from identification.built_system import BuiltSystem
from identification.design.study import DesignStudy
from identification.estimation.arrow_least_squares import Loss, WindowBlock
from identification.estimation.noise import Coloured, coloured
from identification.estimation.uncertainty import basis, without
from identification.estimation.workers import LocalPool
from identification.output_error.free_runs.simulator import FreeRuns
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.problem import Problem
from identification.output_error.study_checks import ports_of
from identification.output_error.times.spans import at_most
from identification.output_error.windows import counted, cut_windows, initial_states
from identification.recordings.campaign import StudyTrace
from orchestrator.assembly.assembly import OpenSystem, assemble
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import settable, typed
from orchestrator.system import Endpoint, System
from orchestrator.trace import FloatArray, Trace

SILENT = 1e-9  # part of an output's spread, below which there is no noise


@dataclass(frozen=True, eq=False)
class FitRows:
    """What a fit has of an experiment's windows, weighed by the noise roughly.

    Attributes:
        slopes: (K m, n) a window, by the free parameters in z, the start values taken out.
        residuals: (K m,) a window, the same way.
        starts: (K m, r) a window, orthonormal columns of what start values explain.
        given: (m,) variances of outputs whose noise the study gives; nan of others.
    """

    slopes: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    starts: tuple[FloatArray, ...]
    given: FloatArray


def noise_of(rows: Sequence[FitRows]) -> Coloured:
    """The noise of recordings that are fitted together, one process an output, as the calibration finds it: in what the
    parameters that fit best leave."""
    given = rows[0].given
    slopes, residuals, starts = (
        [one for row in rows for one in getattr(row, name)] for name in ("slopes", "residuals", "starts")
    )
    triangle = np.linalg.qr(np.vstack([np.linalg.qr(one, mode="r") for one in slopes]), mode="r")
    seen = np.linalg.pinv(triangle, rcond=1e-10)
    spanned = [one @ seen for one in slopes]  # together orthonormal
    share = np.sum([one.T @ residual for one, residual in zip(spanned, residuals, strict=True)], axis=0)
    left = [residual - one @ share for one, residual in zip(spanned, residuals, strict=True)]
    taken = [np.column_stack(pair) for pair in zip(starts, spanned, strict=True)]
    covariance = coloured(left, len(given), taken).autocovariance.copy()
    known = np.isfinite(given)
    covariance[known] = 0.0
    covariance[known, 0] = given[known]
    return Coloured(covariance)


def information(rows: Sequence[FitRows]) -> FloatArray:
    """(n, n) about the parameters: the inverse of what estimates scatter by, under one noise an output."""
    noise = noise_of(rows)
    slopes = [one for row in rows for one in row.slopes]
    curvature = np.sum([one.T @ one for one in slopes], axis=0)
    return told(curvature, np.sum([one.T @ noise.times(one) for one in slopes], axis=0))


def told(curvature: FloatArray, scatter: FloatArray) -> FloatArray:
    """(n, n) information of least squares that scatter by H^-1 M H^-1, of a curvature H and a scatter M."""
    length = np.sqrt(np.diag(scatter))
    length = np.where(length > 0, length, 1.0)
    values, vectors = np.linalg.eigh(scatter / np.outer(length, length))
    kept = values > SILENT * max(float(values[-1]), 0.0)
    turned = (curvature / length[:, None]).T @ vectors[:, kept]
    return np.asarray(turned / values[kept] @ turned.T)


@dataclass(frozen=True, eq=False)
class Tried:
    """An experiment that was tried.

    Attributes:
        values: component.variable of the rig -> what it was given.
        whole: the rig's run: inputs and outputs of the calibration, and what has limits.
        recording: what its recorder gives.
        curvature: (n, n) of the squares that a fit minimises by the free parameters, in z.
        scatter: (n, n) of their slopes under the noise.
        noise: (m,) standard deviation of a compared sample of each output.
    """

    values: Mapping[str, Value]
    whole: Trace
    recording: Trace
    rows: FitRows
    curvature: FloatArray
    scatter: FloatArray
    noise: FloatArray

    @property
    def level(self) -> float:
        """How much its slopes scatter at each curvature, over all directions that it shows."""
        seen = np.diag(self.curvature) > 0
        return float(np.mean(np.diag(self.scatter)[seen] / np.diag(self.curvature)[seen])) if seen.any() else 1.0


def roughly(experiments: Sequence[Tried]) -> FloatArray:
    """(n, n) the information of recordings that are fitted together, each scattering at their mean level."""
    level = float(np.mean([one.level for one in experiments]))
    curvature = np.sum([one.curvature for one in experiments], axis=0)
    return told(curvature, np.sum([one.scatter * (level / one.level) for one in experiments], axis=0))


class DesignBench:
    """The rig and the model of a study, opened once; a context manager that frees them.

    Attributes:
        units: of the rig's variables that are limited or driven, and of the free parameters.
        remarks: what a reader must know of how information is had.

    Raises:
        InputError: they do not fit together.
    """

    def __init__(self, study: DesignStudy) -> None:
        self.study, self._stack = study, ExitStack()
        try:
            self._open_rig()
            self._open_model()
        except BaseException:
            self._stack.close()
            raise
        self._tally = Tally()
        self._scale: FloatArray | None = None  # (m,) of the outputs' noise, roughly

    def _open_rig(self) -> None:
        study, rig = self.study, self.study.rig
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="servotwin-")))
        assembled = assemble(rig.system, folder, rig.driven)
        opened = self._stack.enter_context(OpenSystem(assembled))
        self._rig: System = opened.system
        self._scenario, _ = in_units_of(opened.system, rig)
        known = {name: value for name, value in study.values.items() if _is_there(opened.system, name)}
        self._given = {**assembled.system.values(), **known}
        self.elsewhere = sorted(study.values.keys() - known.keys())
        timing = replace(rig.timing, stop=rig.timing.start + study.duration)
        self._simulation: Simulation = opened.simulation(timing)
        logger = rig.logger
        self._recorded = [
            *(() if logger is None else logger.signals.values()),
            *study.limits,
            *study.calibration.outputs,
        ]
        self._recorded += [name for name in study.calibration.run.inputs if _is_there(opened.system, name)]
        if logger is None:
            self._recorded += self._simulation.outputs
        self._recorded = list(dict.fromkeys(self._recorded))
        for place, names in (("limits", study.limits), ("outputs of the calibration", study.calibration.outputs)):
            for name in names:
                opened.system.port(Endpoint.parse(name), f"{place}.{name}")
        for space in map(study.space, study.families):
            for name in space:
                settable(opened.system, name)
        instants = self._simulation.instants() if rig.stimuli else np.zeros(0)
        self._stimuli = {n: one.values(instants, n) for n, one in self._scenario.stimuli.items()}

    def _open_model(self) -> None:
        asked = self.study.calibration
        system = BuiltSystem(asked.system, sorted(asked.run.inputs))
        opened = self._stack.enter_context(OpenSystem(system.assembled))
        self._ports = ports_of(asked, opened.system)
        self.units = {
            name: opened.system.port(Endpoint.parse(name)).unit or "1" for name in asked.parameters.names if "." in name
        }
        self._values = system.assembled.system.values()
        longest = at_most(asked.said_windows.length, self.study.duration, asked.run.step)
        self._model: Simulation = opened.simulation(asked.run.timing(longest))
        self._kept = system

    @property
    def channels(self) -> tuple[str, ...]:
        """Seeds of the rig's components that are driven by others: of their noise."""
        parts = self._rig.parts.items()
        return tuple(
            f"{name}.seed" for name, part in parts if part.interface.of("input") and "seed" in part.interface.ports
        )

    def unit(self, name: str) -> str:
        """Of a variable of the rig."""
        return self._rig.port(Endpoint.parse(name)).unit or ""

    def run(self, values: Mapping[str, Value]) -> Trace:
        """The rig's run with these values.

        Raises:
            FmuError: an FMU failed.
        """
        given = {**self._given, **typed(self._rig, values)}
        return self._simulation.execute(Run(given, self._stimuli, self._recorded)).trace

    def exceeded(self, whole: Trace) -> dict[str, float]:
        """Limited variable -> the value that is farthest beyond its limit, of those that are exceeded."""
        found = {}
        for name, limit in self.study.limits.items():
            farthest = max(float(whole[name].min()), float(whole[name].max()), key=limit.beyond)
            if limit.beyond(farthest) > 0:
                found[name] = farthest
        return found

    def tried(self, values: Mapping[str, Value], whole: Trace) -> Tried:
        """What an experiment tells, that ran like this.

        Raises:
            FmuError: the model fails on it.
            InputError: its recording does not fit the calibration's study.
        """
        recording = self._recording(whole, 0)
        windows = self._windows(recording, values)
        if self._scale is None:
            self._scale = np.sqrt(self._noise(windows)[1].autocovariance[:, 0])
        rows, noise = self._noise([replace(window, weight=1 / self._scale) for window in windows])
        curvature = np.sum([one.T @ one for one in rows.slopes], axis=0)
        scatter = np.sum([one.T @ noise.times(one) for one in rows.slopes], axis=0) * counted(windows)
        deviation = np.sqrt(noise.autocovariance[:, 0]) * self._scale
        return Tried(values, whole, recording, rows, curvature, scatter, deviation)

    @property
    def differences(self) -> str:
        """Why information is by differences; nothing where it is by tangents."""
        return self._tally.differences

    def again(self, values: Mapping[str, Value], draw: int) -> FitRows:
        """What a fit would have of an experiment that was tried, with other noise and other instants of its recorder.

        Raises:
            FmuError: an FMU failed.
        """
        seeds = {name: 1000 * draw + place for place, name in enumerate(self.channels) if name not in values}
        windows = self._windows(self._recording(self.run({**values, **seeds}), draw), values)
        assert self._scale is not None
        return self._noise([replace(window, weight=1 / self._scale) for window in windows])[0]

    def _recording(self, whole: Trace, draw: int) -> Trace:
        logger = self._scenario.logger
        return whole if logger is None else logger.sample(whole, draw)

    def _windows(self, recording: Trace, values: Mapping[str, Value]) -> list[FreeRunWindow]:
        asked = self.study.calibration
        known = {**self._given, **typed(self._rig, values)}
        constants = {name: known[name] if name in known else self._start(name) for name in asked.traces.values}
        file = self.study.rig_file
        trace = StudyTrace(replace(recording, name="experiment"), {}, file, "", "simulated", values=constants)
        return cut_windows(asked.run, [trace], asked.said_windows, self._ports)

    def _start(self, name: str) -> Value:
        """The value that a component of the rig has by itself."""
        port = self._rig.port(Endpoint.parse(name), f"traces.values.{name}")
        if port.start is None:
            raise ScenarioError(f"traces.values.{name}", "has no value in the rig's scenario", "set it there")
        return port.parsed(port.start)

    def _blocks(self, windows: Sequence[FreeRunWindow]) -> list[WindowBlock]:
        """Residuals and Jacobians of the windows at the known parameters."""
        asked = self.study.calibration
        states = initial_states(asked.run, windows)
        problem = Problem(asked.parameters, tuple(windows), asked.outputs, states, Loss())
        numbers = tuple(range(len(windows)))
        runs = FreeRuns(self._model, windows, asked.outputs, self._values)
        step = asked.options.difference_step
        work = FreeRun(problem, LocalPool(lambda: runs), self._tally, numbers, step, tangents=True)
        begin = problem.start(numbers)
        residuals = work.residuals(begin)
        if residuals is None:
            raise FmuError("experiment", f"its model fails: {self._tally.reasons[-1]}", "narrow its family")
        return work.linearise(begin, residuals, central=True)

    def _noise(self, windows: Sequence[FreeRunWindow]) -> tuple[FitRows, Coloured]:
        """What a fit has of windows, and its noise."""
        asked = self.study.calibration
        weight = windows[0].weight
        known = [self.study.noise.get(name, math.nan) for name in asked.outputs]
        blocks = self._blocks(windows)
        slopes = tuple(without(block.parameters, block.states) for block in blocks)
        residuals = tuple(without(block.residual[:, None], block.states)[:, 0] for block in blocks)
        starts = tuple(basis(block.states) for block in blocks)
        rows = FitRows(slopes, residuals, starts, (weight * np.array(known)) ** 2)
        noise = noise_of([rows])
        for number, name in enumerate(asked.outputs):
            variance = noise.autocovariance[number, 0]
            spread = float(weight[number] * np.concatenate([window.measured[:, number] for window in windows]).std())
            if not (math.isfinite(variance) and variance > (SILENT * spread) ** 2):
                unit = self._ports[name].unit or "its unit"
                fix = f"give `noise: {{{name}: ...}}`, the standard deviation of a compared sample [{unit}]"
                raise IdentificationError(f"noise.{name}", "the sensors in the rig's scenario add none", fix)
        return rows, noise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _is_there(system: System, name: str) -> bool:
    component, _, variable = name.partition(".")
    return component in system.parts and variable in system.parts[component].interface.ports
