"""What is written of the real robot predicts unseen recordings in plain FMPy, whatever the importer's step."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from scipy.io import loadmat

from identification.calibrate import calibrate
from identification.estimation.validation import fit
from identification.study import load_study
from orchestrator.trace import FloatArray

STUDY = Path(__file__).parents[3] / "scenarios" / "butterfly" / "calibration.yaml"
BEGIN, LENGTH, HALF_WIDTH = 10.0, 4.0, 0.018  # [s]


class Imported:
    """An FMU as FMPy runs it."""

    def __init__(self, file: Path) -> None:
        described = fmpy.read_model_description(str(file))
        self._numbers = {variable.name: variable.valueReference for variable in described.modelVariables}
        self._fmu = FMU2Slave(
            guid=described.guid,
            unzipDirectory=fmpy.extract(str(file)),
            modelIdentifier=described.coSimulation.modelIdentifier,
            instanceName="imported",
        )
        self._fmu.instantiate()

    def begin(self, **values: float) -> None:
        self._fmu.reset()
        self._fmu.setupExperiment(startTime=0.0)
        self.set(**values)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        self._fmu.setReal([self._numbers[name] for name in values], list(values.values()))

    def get(self, name: str) -> float:
        return float(self._fmu.getReal([self._numbers[name]])[0])

    def step(self, time: float, step: float) -> None:
        self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=step)


def run(motor: Imported, hand: Imported, voltage: Sequence[float], step: float) -> FloatArray:
    """(K + 1,) angles [rad], each voltage held over a step."""
    angles = [hand.get("angle")]
    for k, volts in enumerate(voltage):
        motor.set(voltage=volts, speed=hand.get("speed"))
        motor.step(k * step, step)
        hand.set(torque=motor.get("torque"))
        hand.step(k * step, step)
        angles.append(hand.get("angle"))
    return np.array(angles)


def predicted(motor: Imported, hand: Imported, file: Path, step: float) -> float:
    """FIT of one window of a recording, nothing set but the added mass and where it starts."""
    data = loadmat(file)["D"]
    time, rows = np.unique(data[:, 0] - data[0, 0], return_index=True)
    voltage, angle = data[rows, 1], data[rows, 2]
    near = np.abs(time - BEGIN) <= HALF_WIDTH
    _, speed, start = np.polyfit(time[near] - BEGIN, angle[near], 2)
    mass = re.match(r"Data_(\d+(_\d+)?)__", file.stem)
    assert mass is not None
    hand.begin(added_mass=1e-3 * float(mass[1].replace("_", ".")), angle_start=start, speed_start=speed)
    motor.begin()
    grid = BEGIN + step * np.arange(round(LENGTH / step) + 1)
    held = voltage[np.searchsorted(time, grid[:-1], side="right") - 1]
    return float(fit(np.interp(grid, time, angle), run(motor, hand, held.tolist(), step))[0])


@pytest.mark.slow
def test_the_real_robots_fmus_predict_unseen_recordings_alike_at_any_step(butterfly_data: Path, tmp_path: Path) -> None:
    calibrate(STUDY, butterfly_data).write(tmp_path / "robot")
    motor, hand = (Imported(tmp_path / "robot" / "fmus" / f"{name}.fmu") for name in ("motor", "hand"))
    unseen = [butterfly_data / f"{name}.mat" for name in load_study(STUDY).block.traces.hold_out]
    fits = {step: np.array([predicted(motor, hand, file, step) for file in unseen]) for step in (0.001, 0.002)}
    for found in fits.values():
        assert np.median(found) > 0.965
        assert found.min() > 0.92
    assert fits[0.001] == pytest.approx(fits[0.002], abs=0.01)
