"""The class that pythonfmu calls inside a Python FMU: an `Instance` behind value references.

This file travels inside the FMU, beside the model it runs; it reads defaults and tables from the FMU's resources.
"""

import atexit
import ctypes
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from ...modelling.instance import REFUSED, Instance, Snapshot, StepError
from ...modelling.model import Model, Table
from ..defaults import load


def read_table(folder: Path, name: str) -> Table:
    """The samples in `<name>.csv` (time, value; one line of header), an empty table where there is no such file."""
    file = folder / f"{name}.csv"
    if not file.is_file():
        return Table(name)
    rows = [line.split(",") for line in file.read_text().splitlines()[1:] if line]
    return Table(name, tuple(float(row[0]) for row in rows), tuple(float(row[1]) for row in rows))


def hold_module(namespace: dict[str, Any]) -> None:
    """Add one reference to a module's namespace: pythonfmu 0.7 drops one that is not its own with every instance."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(namespace))


def release_at_exit(library: Path) -> None:
    """Have pythonfmu 0.7 let go of Python as Python ends: later, as the process does, it writes into freed memory."""
    if sys.platform == "linux":
        atexit.register(ctypes.CDLL(str(library)).finalizePythonInterpreter)


class ModelSlave(Fmi2Slave):
    """A co-simulation slave; the shim of each FMU sets `model`, and of requirements
    that depend on parameters alone, by their number, these.

    pythonfmu answers an exception with a fatal error, after which an importer that goes on crashes. So whatever a model
    raises is logged instead; values that could not be computed are NaN, and every step from then on is an error. So are
    parameters that do not fit together, which is said as the initialisation ends.
    """

    model: Model
    conflicts: Mapping[int, Sequence[str]]

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        hold_module(sys.modules[type(self).__module__].__dict__)
        folder = Path(self.resources)
        defaults = load((folder / "defaults.txt").read_text())
        tables = {name: read_table(folder, name) for name in self.model.tables}
        self.instance = Instance(self.model, defaults, tables)
        self.names = [variable.name for variable in self.model.variables]
        self.failed = False

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        self.instance.begin(start_time)

    def exit_initialization_mode(self) -> None:
        conflict = self.instance.conflict(self.conflicts)
        if conflict:
            self.failed = True
            self.log(f"{self.model.name}: {conflict}", Fmi2Status.error, REFUSED)

    def do_step(self, current_time: float, step_size: float) -> bool:
        if self.failed:
            return False
        try:
            self.instance.step(current_time, step_size)
        except Exception as error:
            self._fail(error)
        return not self.failed

    def get_real(self, vrs: list[int]) -> list[float]:
        get, names = self.instance.get, self.names
        try:
            return [float(get(names[vr])) for vr in vrs]
        except Exception as error:
            self._fail(error)
            return [math.nan] * len(vrs)

    def get_integer(self, vrs: list[int]) -> list[int]:
        return [int(self.instance.get(self.names[vr])) for vr in vrs]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        return [bool(self.instance.get(self.names[vr])) for vr in vrs]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        set_, names = self.instance.set, self.names
        try:
            for vr, value in zip(vrs, values, strict=True):
                set_(names[vr], value)
        except Exception as error:
            self._fail(error)

    set_integer = set_real
    set_boolean = set_real

    def _get_fmu_state(self) -> Snapshot:
        return self.instance.snapshot()

    def _set_fmu_state(self, state: Snapshot) -> None:
        try:
            self.instance.restore(state)
            self.failed = False
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failed = True
        reason = str(error) if isinstance(error, StepError) else f"{type(error).__name__}: {error}"
        self.log(f"{self.model.name}: {reason}", Fmi2Status.error)
