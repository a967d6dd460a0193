"""One FMU opened with FMPy alone, as another tool would: nothing of the project stands between it and the tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions


class Loaded:
    """An FMI 2.0 slave whose values are known by name; `log` gathers what it says."""

    def __init__(self, path: Path, folder: str) -> None:
        self.description = read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.log: list[str] = []
        self.slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="tested",
        )
        self.slave.instantiate(callbacks=self._callbacks(), loggingOn=True)

    def start(self, time: float = 0.0, **values: float) -> None:
        """Initialise with these start values."""
        self.slave.setupExperiment(startTime=time)
        for name, value in values.items():
            self.set(name, value)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        self.slave.setReal([self.references[name]], [value])

    def get(self, *names: str) -> list[float]:
        values: list[float] = self.slave.getReal([self.references[name] for name in names])
        return values

    def step(self, time: float, duration: float) -> None:
        self.slave.doStep(currentCommunicationPoint=time, communicationStepSize=duration)

    def _callbacks(self) -> Any:
        def log(environment: Any, instance: bytes, status: int, category: bytes, message: bytes, *_: Any) -> None:
            self.log.append(message.decode())

        callbacks = fmi2CallbackFunctions()
        for name, kind in callbacks._fields_:
            if name == "logger":
                callbacks.logger = kind(log)
        self._kept = callbacks
        return callbacks


@contextmanager
def loaded(path: Path) -> Iterator[Loaded]:
    """The FMU, unpacked, instantiated, and freed at the end."""
    folder = extract(str(path))
    try:
        fmu = Loaded(path, folder)
        yield fmu
        fmu.slave.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
