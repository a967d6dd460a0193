"""The calibration of the Butterfly's study beside FMPy with SciPy: the same FMUs, windows and tolerances.

Both run in one process, FMUs built and windows cut before. The other steps two FMUs of FMPy's slaves in the same order,
the inner loop as short as it can be, and has the Jacobian from forward differences, as its users do.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from scipy.optimize import least_squares

from identification.output_error.calibration import PreparedStudy
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.study import WindowSpec
from identification.output_error.windows import weighed
from identification.recordings.campaign import load_campaign
from identification.study import load_study
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray

from ..figure import Figure

ROOT = Path(__file__).parents[3]
STUDY = ROOT / "scenarios" / "butterfly" / "calibration.yaml"
RECORDINGS, FASTER, NEARER = 2, 15, 1.01  # so few are fitted in one process


def figures() -> list[Figure]:
    """Processor time of both, and whose estimate is better."""
    data = Path(os.environ.get("SERVOTWIN_DATA", ROOT.parent / "shared" / "data")) / "butterfly"
    if not data.is_dir():
        return [Figure("calibration beside FMPy with SciPy", "recordings", f"none in {data} (set SERVOTWIN_DATA)")]
    prepared = prepare(data)
    begun = process_time()
    found = prepared.calibrated()
    ours = process_time() - begun
    peer = Peer(prepared)
    mine = peer.cost(found.estimate.values)
    begun = process_time()
    theirs, steps = peer.least_squares()
    spent = process_time() - begun
    return [
        Figure(
            f"calibration on {RECORDINGS} windows of 4 s, uncertainty included: processor time", "-", f"{ours:.2f} s"
        ),
        Figure("FMPy with SciPy's least_squares, no uncertainty", "-", f"{spent:.1f} s, {steps} Jacobians"),
        Figure("it takes x times ours", f"at least {FASTER}", f"{spent / ours:.0f}", spent >= FASTER * ours),
        Figure(
            "our cost over the other's, by the other's simulation",
            f"at most {NEARER}",
            f"{mine / theirs:.5f}",
            mine <= NEARER * theirs,
            certain=True,
        ),
    ]


def prepare(data: Path) -> PreparedStudy:
    """The study on one window of each of few recordings."""
    study = load_study(STUDY)
    block = study.block
    assert isinstance(block, OutputErrorBlock)
    asked = block.study(block.system(study.base), block.source(study.base))
    assert isinstance(asked.windows, WindowSpec)
    recorded = [one for one in load_campaign(asked.traces, data) if one.trace.name not in asked.traces.hold_out]
    traces, windows = replace(asked.traces, hold_out=()), replace(asked.windows, most=1)
    asked = replace(asked, traces=traces, windows=windows, compare={})
    return PreparedStudy.of(asked, recorded[:: len(recorded) // RECORDINGS][:RECORDINGS])


class Peer:
    """FMPy's slaves of a motor and its hand, stepped one after the other."""

    def __init__(self, prepared: PreparedStudy) -> None:
        self.study, self.windows = prepared.study, weighed(prepared.study, prepared.train)
        self.free = prepared.study.parameters.parameters
        self.logs = [one.scale == "log" for one in self.free]
        self.files = prepared.system.assembled.files

    def least_squares(self) -> tuple[float, int]:
        """The cost that SciPy reaches, and its iterations."""
        start, low, high = (
            [math.log(value) if log else value for value, log in zip(values, self.logs, strict=True)]
            for values in zip(*((one.start, one.lower, one.upper) for one in self.free), strict=True)
        )
        options, loss = self.study.options, self.study.loss
        with self._opened():
            found = least_squares(
                lambda x: self.residuals(self._values(x)),
                start,
                bounds=(low, high),
                x_scale="jac",
                diff_step=options.difference_step,
                ftol=options.cost_tolerance,
                xtol=options.step_tolerance,
                loss=loss.kind,
                f_scale=loss.scale,
            )
        return float(found.cost), int(found.njev)

    def cost(self, values: Mapping[str, float]) -> float:
        """Of these values, as SciPy counts it."""
        with self._opened():
            residuals = self.residuals({one.name: values[one.name] for one in self.free})
        return self.study.loss.cost([residuals])

    def _values(self, x: Sequence[float]) -> dict[str, float]:
        return {one.name: math.exp(z) if log else float(z) for one, log, z in zip(self.free, self.logs, x, strict=True)}

    def residuals(self, values: Mapping[str, float]) -> FloatArray:
        """(N,) weighted differences of all windows."""
        known: dict[str, Value] = self.study.system.values()
        return np.concatenate([self._run(window, {**known, **window.constants, **values}) for window in self.windows])

    def _run(self, window: FreeRunWindow, values: Mapping[str, Value]) -> FloatArray:
        given = {**values, **window.initial}
        motor, hand = (self.slaves[name] for name in ("motor", "hand"))
        for name, slave in self.slaves.items():
            slave.reset()
            slave.setupExperiment(startTime=0.0)
            own = {key.partition(".")[2]: value for key, value in given.items() if key.startswith(f"{name}.")}
            slave.setReal([self.places[name][key] for key in own], list(map(float, own.values())))
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        inputs = [self.places["motor"][key] for key in ("voltage", "speed")]
        torque_out, torque_in = [self.places["motor"]["torque"]], [self.places["hand"]["torque"]]
        state = [self.places["hand"][key] for key in ("angle", "speed")]
        step, angles = float(window.step), []
        angle, speed = hand.getReal(state)
        for k, voltage in enumerate(window.driven({})["motor.voltage"].tolist()):
            angles.append(angle)
            motor.setReal(inputs, [voltage, speed])
            motor.doStep(k * step, step)
            hand.setReal(torque_in, motor.getReal(torque_out))
            hand.doStep(k * step, step)
            angle, speed = hand.getReal(state)
        simulated = np.array(angles)[window.at.astype(int), None]
        return np.asarray((window.weight * (simulated - window.measured)).ravel())

    @contextmanager
    def _opened(self) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            self.slaves, self.places = {}, {}
            for name, file in self.files.items():
                described = fmpy.read_model_description(str(file))
                unpacked = fmpy.extract(str(file), str(Path(folder) / name))
                slave = FMU2Slave(
                    guid=described.guid,
                    unzipDirectory=unpacked,
                    modelIdentifier=described.coSimulation.modelIdentifier,
                    instanceName=name,
                )
                slave.instantiate()
                self.slaves[name] = slave
                self.places[name] = {one.name: one.valueReference for one in described.modelVariables}
            yield
            for slave in self.slaves.values():
                slave.freeInstance()
