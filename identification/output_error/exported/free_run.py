"""A free run of a study as a scenario of the calibrated FMUs, with the latencies that the study has, and as an SSP."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import InputError
from fmus.files import RawMap
from fmus.packaging import archive
from fmus.parameters.write_back import description_of, is_ours
from identification.estimation.groups import own_values
from identification.output_error.calibration import Calibration, judge
from identification.output_error.exported.latencies import Latency, latencies
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.times.delays import Estimated, estimated
from identification.output_error.times.instants import every_step
from orchestrator import formats
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Value
from orchestrator.rational import written
from orchestrator.scenario.exchange import export
from orchestrator.system import component_values
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import text_of

LOG = logging.getLogger("servotwin.calibration")
SCENARIO, SYSTEM = "free_run.yaml", "free_run.ssp"
COMMANDS, OUTPUTS = "free_run_commands.csv", "free_run_outputs.csv"
CLOSE = "1 %"  # of the range: what a latency's past before the window, of which one value stands for all, may change


def write_free_run(calibration: Calibration, folder: Path, target: Path) -> None:
    """Write the first fitted window as a scenario and, where components are connected, as an SSP."""
    run = _FreeRun(calibration, folder)
    for name, columns, time in ((COMMANDS, run.commands(), run.time), (OUTPUTS, run.outputs(), run.compared)):
        if columns:
            units = {signal: unit for signal in columns if (unit := run.unit(signal)) is not None}
            formats.write(Trace(time, columns, units), folder / name)
    document = run.document()
    (folder / SCENARIO).write_bytes(text_of(document))
    if document["connections"]:
        try:
            export(folder / SCENARIO, folder / SYSTEM)
        except InputError as refusal:  # what was calibrated is not lost with it
            LOG.warning("%s is not written: %s", SYSTEM, refusal)


class _FreeRun:
    """The first fitted window, and what of it goes through components that bring latencies."""

    def __init__(self, calibration: Calibration, folder: Path) -> None:
        self.calibration, self.folder = calibration, folder
        self.window, self.simulated = _at_every_step(calibration)
        self.values = own_values(calibration.study.grouped, self.window.trace, calibration.estimate.values)
        self.late = {one.end: one for one in latencies(calibration) if not one.obstacle}
        self.time = np.asarray(np.arange(self.window.count) * float(self.window.step))
        self.compared = self.time[self.window.at.astype(np.int64)]

    def unit(self, name: str) -> str | None:
        """The unit of a variable; None where a latency's component stands for it, or it has none."""
        return self.calibration.system.port(name).unit if name not in self.late else None

    def commands(self) -> dict[str, FloatArray]:
        """component.input -> (K,) what drives it or its latency from each instant to the next."""
        driven = self.window.driven(self.values)
        return {
            name: self.window.commands[name].values(self.window.run_time, 0.0) if name in self.late else values
            for name, values in driven.items()
        }

    def outputs(self) -> dict[str, FloatArray]:
        """component.output -> (K',) what the study predicts of it."""
        return dict(zip(self.calibration.train.outputs, self.simulated.T, strict=True))

    def document(self) -> RawMap:
        """The scenario."""
        study = self.calibration.study
        said = f"What the study predicts of {self.window.name}, by the calibrated FMUs."
        run: RawMap = {"stop": written(self.window.stop), "step": written(self.window.step)}
        run |= {} if study.run.tolerance is None else {"tolerance": study.run.tolerance}
        run |= {} if study.run.finite else {"nonfinite": "allow"}
        run |= {"tell_stop": True} if study.run.tell_stop else {}
        stimuli = {
            self._outside(name): {"file": COMMANDS, "signal": name, "interpolation": "hold", "ends": "hold"}
            for name in self.window.driven(self.values)
        }
        wired = [f"{source} -> {target}" for source, target in study.system.connections]
        return {
            "title": f"A free run: {study.title}",
            "description": " ".join([said, *self._told()]),
            "components": self._components(),
            "connections": [*wired, *(link for one in self.late.values() for link in one.links)],
            "stimuli": stimuli,
            "run": run,
            "record": list(dict.fromkeys([*study.outputs, *map(self._outside, study.outputs)])),
            "expect": self._expected(),
        }

    def _outside(self, name: str) -> str:
        return self.late[name].outside if name in self.late else name

    def _told(self) -> list[str]:
        """What is to be known of latencies."""
        return [
            f"{one.component} brings the {one.own:.4g} s by which {one.end} is {one.verb} late."
            for one in self.late.values()
        ]

    def _components(self) -> RawMap:
        components = self.calibration.study.system.components
        own = {name: self._component(name, component) for name, component in components.items()}
        return own | {one.component: self._latency(one) for one in self.late.values()}

    def _component(self, name: str, spec: ComponentSpec) -> RawMap:
        entry: RawMap = {"fmu": _fmu(name)}
        values = {**self._written(name), **component_values(name, self._of_window())}
        if values:
            entry["parameters"] = {key: _plain(value) for key, value in values.items()}
        if spec.step is not None:
            entry["step"] = written(spec.step)
        if spec.feed_through != ComponentSpec.feed_through:
            entry["feed_through"] = spec.feed_through
        if spec.solver is not None:
            entry["solver"] = {key: _plain(value) for key, value in vars(spec.solver).items()}
        return entry

    def _written(self, name: str) -> Mapping[str, Value]:
        """The values that an FMU cannot hold."""
        contents = archive.read(self.folder / _fmu(name))
        if is_ours(contents, description_of(Path(name), contents)):
            return {}
        values = {key: value for key, value in self.calibration.estimate.values.items() if "." in key}
        return self.calibration.system.calibrated(values)[name].values

    def _of_window(self) -> dict[str, Value]:
        """component.variable -> what is of this window alone."""
        states = {name: float(found[0]) for name, found in self.calibration.estimate.initial_states.items()}
        grouped = {one.variable for one in self.calibration.study.grouped if "." in one.variable}
        own = {name: self.values[name] for name in sorted(grouped)}
        return {**self.window.constants, **own, **states, **self.window.start_values(self.values)}

    def _latency(self, one: Latency) -> RawMap:
        values = {} if one.own == one.seconds else {"delay": one.own}
        values |= {"before": self._before(one)} if one.command else {}
        return {"fmu": _fmu(one.component)} | ({"parameters": values} if values else {})

    def _before(self, one: Latency) -> float:
        """What was on its way to an input when the window began, over what it is then."""
        held, begin = self.window.commands[one.end].held, self.window.start
        if not begin - one.own < begin:
            return 0.0
        [mean] = held.means(np.array([begin - one.own, begin]))
        return float(mean - self.commands()[one.end][0])

    def _expected(self) -> list[RawMap]:
        """That the run is the study's, where an output moves."""
        first, last = float(self.compared[0]), float(self.compared[-1])
        part = {} if len(self.compared) == len(self.time) else {"after": first, "before": last}
        return [
            {"signal": self._compared(name), **part, "reference": {"file": OUTPUTS, "signal": name}}
            | {"nrmse": {"at_most": CLOSE}}
            for name, values in self.outputs().items()
            if np.ptp(values) > 0
        ]

    def _compared(self, name: str) -> str:
        """What the study's prediction of an output is of: itself where its delay is known, for stamps are corrected."""
        spec = self.calibration.study.run.outputs[name]
        return self._outside(name) if isinstance(spec.delay, Estimated) else name


def _at_every_step(calibration: Calibration) -> tuple[FreeRunWindow, FloatArray]:
    """The first fitted window, and its free run (K', m) at every step, also where a recording comes less often."""
    study, window = calibration.study, calibration.train.windows[0]
    at, delays = every_step(window.delays, window.step, window.count), estimated(window.delays)
    if np.array_equal(at, window.at):
        return window, calibration.train.simulated[0]
    found = {name: float(values[0]) for name, values in calibration.estimate.initial_states.items()}
    nothing = np.zeros((len(at), len(study.outputs)))
    whole = replace(window, at=at, delays=delays, measured=nothing, initial={**window.initial, **found})
    known = {name: replace(spec, estimated=False) for name, spec in study.run.initial.items()}
    asked = replace(study, run=replace(study.run, initial=known))
    judged = judge(asked, calibration.system.assembled, [whole], calibration.estimate.values)
    return whole, judged.simulated[0]


def _fmu(component: str) -> str:
    return f"fmus/{component}.fmu"


def _plain(value: Any) -> Any:
    """As YAML has it."""
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, str) else value
