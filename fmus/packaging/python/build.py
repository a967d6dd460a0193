"""Python FMUs: the model file as it is, run by pythonfmu's library inside the importing process.

The FMU carries the model, the few files it needs and pythonfmu's own; a unique package name made from their contents
lets FMUs of different versions live in one interpreter.
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Mapping
from pathlib import Path

from fmus import library
from fmus.errors import ModelError
from fmus.modelling.model import Model, Number, Table
from fmus.modelling.symbolic import conflicts
from fmus.packaging import archive, defaults, licenses, values
from fmus.packaging.description import exposure, terminals, xml
from fmus.packaging.python import runtime

_ROOT = Path(__file__).parents[2]
_TRAVELS = (
    "models/__init__.py",
    "modelling/control.py",
    "modelling/feedback.py",
    "modelling/friction.py",
    "modelling/instance.py",
    "modelling/late.py",
    "modelling/model.py",
    "modelling/ops.py",
    "modelling/ports.py",
    "packaging/defaults.py",
    "packaging/python/slave.py",
)

_CAPABILITIES = {
    "needsExecutionTool": True,
    "canHandleVariableCommunicationStepSize": True,
    "canGetAndSetFMUstate": True,
    "canSerializeFMUstate": True,
    "canNotUseMemoryManagementFunctions": True,
}

# pythonfmu finds the class by the text "class <name>(Fmi2Slave):".
_SHIM = '''"""Entry point that pythonfmu looks for."""
from pathlib import Path

from {package}.packaging.python.slave import ModelSlave as Fmi2Slave, hold_module, release_at_exit
from {package}.models import {module}

hold_module(globals())
release_at_exit(Path(__file__).parents[1] / "binaries" / "linux64" / "{name}.so")


class Slave(Fmi2Slave):
    model = {module}.{call}
    conflicts = {conflicts}
'''


def build(
    model: Model,
    path: Path,
    parameters: Mapping[str, Number] | None = None,
    tables: Mapping[str, Table] | None = None,
) -> Path:
    """Write the FMU of a model (FMI 2.0, co-simulation) with these defaults and tables; the path comes back.

    Raises:
        ModelError: a parameter or table the model does not have, a value of the wrong type or out of bounds, or a model
            that cannot be traced.
    """
    starts = values.checked(model, parameters or {}, tables or {})
    files = _code(model) | {f"resources/{name}.csv": values.csv(table) for name, table in (tables or {}).items()}
    guid = str(
        uuid.uuid5(uuid.NAMESPACE_URL, f"servotwin:{model.name}:{archive.digest(files)}:{defaults.dump(starts)}")
    )
    files[defaults.RESOURCE] = defaults.dump(starts).encode()
    files[licenses.NAME] = licenses.python()
    offer = xml.Offer("CoSimulation", model.name, _CAPABILITIES)
    shown = exposure.plain(model, starts)
    files["modelDescription.xml"] = xml.fmi2(shown, guid, [offer])
    files |= terminals.files(shown, 2)
    archive.write(path, files)
    return path


def _code(model: Model) -> dict[str, bytes]:
    """Sources, pythonfmu's files and binaries, and the shim, by archive name."""
    source = library.source_file(model)
    modules = {name: (_ROOT / name).read_bytes() for name in _TRAVELS} | {f"models/{source.name}": source.read_bytes()}
    package = f"{model.name}_{archive.digest(modules | {'': model.call.encode()})[:12]}"
    files = {f"resources/{package}/{name}": text for name, text in modules.items()}
    folders = ("", "modelling/", "packaging/", "packaging/python/")
    files |= {f"resources/{package}/{folder}__init__.py": b"" for folder in folders}
    shim = f"{package}_slave"
    files[f"resources/{shim}.py"] = _SHIM.format(
        package=package, module=source.stem, name=model.name, call=model.call, conflicts=conflicts(model)
    ).encode()
    files["resources/slavemodule.txt"] = shim.encode()
    files |= runtime.files(model.name)
    here = {"win32": "win64", "darwin": "darwin64"}.get(sys.platform, f"{sys.platform}64")
    if not any(name.startswith(f"binaries/{here}/") for name in files):
        raise ModelError(f"model {model.name}", "pythonfmu has no binary for this platform", "build it natively")
    return files
