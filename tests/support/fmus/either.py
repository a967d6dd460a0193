"""One native FMU opened with FMPy alone, FMI 2.0 or 3.0, behind one face; nothing of the project stands between."""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions
from fmpy.fmi3 import FMU3Model, FMU3Slave

KINDS = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Int64"}


class Either:
    """An instance whose variables are known by name; `log` gathers (status, category, message)."""

    def __init__(
        self,
        path: Path,
        folder: str,
        exchange: bool = False,
        logging: bool = False,
        log: list[tuple[int, str, str]] | None = None,
        **changed: Any,
    ) -> None:
        self.description = read_model_description(str(path))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.old = self.description.fmiVersion == "2.0"
        self.log = [] if log is None else log
        kind = {(True, True): FMU2Model, (True, False): FMU2Slave, (False, True): FMU3Model, (False, False): FMU3Slave}
        self.fmu = kind[self.old, exchange](
            **{
                "guid": self.description.guid,
                "unzipDirectory": folder,
                "instanceName": "tested",
                "modelIdentifier": self.description.coSimulation.modelIdentifier,
            }
            | changed
        )
        if self.old:
            self.fmu.instantiate(callbacks=self._callbacks(), loggingOn=logging)
        else:
            self.fmu.instantiate(loggingOn=logging, logMessage=self._log3)

    def _log3(self, environment: Any, status: int, category: bytes, message: bytes) -> None:
        self.log.append((status, category.decode(), message.decode(errors="replace")))

    def _callbacks(self) -> Any:
        def log(environment: Any, instance: bytes, status: int, category: bytes, message: bytes, *_: Any) -> None:
            self.log.append((status, category.decode(), message.decode(errors="replace").replace("%%", "%")))

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = dict(callbacks._fields_)["logger"](log)
        self._kept = callbacks
        return callbacks

    def start(self, at: float = 0.0, **values: float) -> None:
        """Initialise with these start values."""
        for name, value in values.items():
            self.set(name, value)
        if self.old:
            self.fmu.setupExperiment(startTime=at)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=at)
        self.fmu.exitInitializationMode()

    def _accessor(self, verb: str, name: str) -> Any:
        kind = self.variables[name].type
        if self.old:
            return getattr(self.fmu, f"{verb}{'Integer' if kind == 'Enumeration' else kind}")
        return getattr(self.fmu, f"{verb}{'Int64' if kind == 'Enumeration' else kind}")

    def set(self, name: str, value: float) -> None:
        """An input or parameter; of an array in FMI 3.0 the whole is set, with one element changed."""
        if name in self.variables:
            of_type = value if self.variables[name].type in ("Real", "Float64") else int(value)
            self._accessor("set", name)([self.variables[name].valueReference], [of_type])
            return
        array, number = self._element(name)
        values = self._array(array)
        values[number] = value
        self.fmu.setFloat64([self.variables[array].valueReference], values)

    def get(self, *names: str) -> list[float]:
        return [
            self._accessor("get", name)([self.variables[name].valueReference])[0]
            if name in self.variables
            else self._array(self._element(name)[0])[self._element(name)[1]]
            for name in names
        ]

    def _element(self, name: str) -> tuple[str, int]:
        """The array of an element, and its number there from 0."""
        array, _, place = name.rstrip("]").partition("[")
        shape = [int(size.start) for size in self.variables[array].dimensions]
        return array, int(np.ravel_multi_index([int(number) - 1 for number in place.split(",")], shape))

    def _array(self, name: str) -> list[float]:
        variable = self.variables[name]
        size = int(np.prod([int(dimension.start) for dimension in variable.dimensions]))
        values: list[float] = self.fmu.getFloat64([variable.valueReference], size)
        return values

    def step(self, time: float, duration: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=duration)

    def save(self) -> Any:
        state = ctypes.c_void_p()
        self._state("Get{}", ctypes.byref(state))
        return state

    def restore(self, state: Any) -> None:
        self._state("Set{}", state)

    def drop(self, state: Any) -> None:
        self._state("Free{}", ctypes.byref(state))

    def serialize(self, state: Any) -> bytes:
        size = ctypes.c_size_t()
        self._state("Serialized{}Size", state, ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self._state("Serialize{}", state, ctypes.cast(data, ctypes.POINTER(self._byte)), size)
        return data.raw

    def deserialize(self, data: bytes) -> Any:
        state = ctypes.c_void_p()
        text = ctypes.cast(ctypes.create_string_buffer(data, len(data)), ctypes.POINTER(self._byte))
        self._state(
            "DeSerialize{}" if self.old else "Deserialize{}", text, ctypes.c_size_t(len(data)), ctypes.byref(state)
        )
        return state

    @property
    def _byte(self) -> Any:
        return ctypes.c_char if self.old else ctypes.c_uint8

    def _state(self, name: str, *arguments: Any) -> None:
        """Call a function about saved states, whose name has a gap for what each version calls them."""
        name = f"fmi2{name}".format("FMUstate") if self.old else f"fmi3{name}".format("FMUState")
        getattr(self.fmu, name)(self.fmu.component, *arguments)

    def sensitivity(self, unknowns: Sequence[str], known: str) -> list[float]:
        """Partial derivatives of some variables by one."""
        vrs = [self.variables[name].valueReference for name in unknowns]
        values: list[float] = self.fmu.getDirectionalDerivative(vrs, [self.variables[known].valueReference], [1.0])
        return values


@contextmanager
def opened(path: Path, **how: Any) -> Iterator[Either]:
    """The FMU, unpacked, instantiated, and freed at the end."""
    folder = extract(str(path))
    try:
        fmu = Either(path, folder, **how)
        yield fmu
        fmu.fmu.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def schema(version: int) -> Path:
    """The XML schema of modelDescription.xml that FMPy brings."""
    return Path(fmpy.__file__).parent / "schema" / f"fmi{version}" / f"fmi{version}ModelDescription.xsd"
