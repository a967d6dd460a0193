"""The FMUs of a study's system, built once and kept as long as a result refers to them."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterable, Mapping
from pathlib import Path

from fmus import library
from fmus.modelling.model import start_values
from identification.method import CalibratedFmu
from orchestrator.assembly.assembly import SystemSpec, assemble
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Port, Value
from orchestrator.system import component_values


class BuiltSystem:
    """A system whose FMUs lie in a folder that is removed with this object.

    Raises:
        InputError: a component names no model and no FMU.
    """

    def __init__(self, system: SystemSpec, stimulated: Iterable[str] = ()) -> None:
        folder = tempfile.mkdtemp(prefix="servotwin-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.assembled = assemble(system, Path(folder), stimulated)

    def calibrated(self, values: Mapping[str, float], step: float | None = None) -> dict[str, CalibratedFmu]:
        """component -> its FMU with the study's values and these by component.variable, for this step [s]."""
        merged = {**self.assembled.system.values(), **values}
        return {
            name: CalibratedFmu(file, component_values(name, merged), step)
            for name, file in self.assembled.files.items()
        }

    def port(self, name: str) -> Port:
        """What an FMU says of component.variable."""
        component, _, variable = name.partition(".")
        return FmuDescription(self.assembled.files[component]).interface.ports[variable]

    def changed(self, values: Mapping[str, float]) -> dict[str, Value]:
        """component.variable -> value, of the study's values and these, those that the FMUs do not start with; these
        always. Where an FMU is of a model of the library, what it starts with counts, too, where the model does not."""
        files = {name: FmuDescription(file) for name, file in self.assembled.files.items()}
        ports = {name: file.interface.ports for name, file in files.items()}
        own = {name: value for name, value in self.assembled.system.values().items() if name not in values}
        kept = {name: value for name, value in own.items() if not _starts_so(ports, name, value)}
        given = {f"{name}.{port}": value for name, file in files.items() for port, value in _not_default(file).items()}
        return {**{name: value for name, value in given.items() if name not in own}, **kept, **values}


def _not_default(file: FmuDescription) -> dict[str, Value]:
    """Parameters of one of our FMUs that its model of the library does not start with."""
    interface = file.interface
    if not file.is_ours or interface.model_name not in library.names():
        return {}
    defaults = start_values(library.find(interface.model_name))
    starts = {port.name: port.parsed(port.start) for port in interface.of("parameter") if port.start is not None}
    return {name: start for name, start in starts.items() if name in defaults and start != defaults[name]}


def _starts_so(ports: Mapping[str, Mapping[str, Port]], name: str, value: Value) -> bool:
    """Whether an FMU starts with this value."""
    component, _, variable = name.partition(".")
    port = ports[component].get(variable)
    return port is not None and port.start is not None and port.parsed(port.start) == value
