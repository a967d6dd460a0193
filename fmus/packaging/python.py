"""Python FMUs: the model file as it is, run by pythonfmu's library inside the importing process.

The FMU carries the model, the few files it needs and pythonfmu's own; a unique package name made from their contents
lets FMUs of different versions live in one interpreter.
"""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Mapping
from pathlib import Path

import pythonfmu
from pythonfmu.builder import FmuBuilder

from fmus import library
from fmus.errors import ModelError
from fmus.model import Model, Number, Table, start_values
from fmus.packaging import archive, defaults, description

_ROOT = Path(__file__).parents[1]
_TRAVELS = ("ops.py", "model.py", "instance.py", "packaging/defaults.py", "packaging/python_slave.py")

# pythonfmu finds the class by the text "class <name>(Fmi2Slave):".
_SHIM = '''"""Entry point that pythonfmu looks for."""
from {package}.packaging.python_slave import ModelSlave as Fmi2Slave, hold_module
from {package}.{module} import MODEL

hold_module(globals())


class Slave(Fmi2Slave):
    model = MODEL
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
    starts = start_values(model)
    _known(model, "variable", parameters or {}, starts)
    _known(model, "table", tables or {}, model.tables)
    values = starts | {name: _checked(model, name, value) for name, value in (parameters or {}).items()}
    files = _code(model) | {
        f"resources/{name}.csv": _csv(table).encode() for name, table in (tables or {}).items()
    }  # fmt: skip
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"servotwin:{model.name}:{_digest(files)}:{defaults.dump(values)}"))
    files[defaults.RESOURCE] = defaults.dump(values).encode()
    files["modelDescription.xml"] = description.fmi2(
        model, guid, values, model.name, needsExecutionTool=True, canHandleVariableCommunicationStepSize=True,
        canGetAndSetFMUstate=True, canSerializeFMUstate=True, canNotUseMemoryManagementFunctions=True,
    )  # fmt: skip
    archive.write(path, files)
    return path


def _known(model: Model, what: str, given: Mapping[str, object], known: Mapping[str, object] | tuple[str, ...]) -> None:
    for name in given:
        if name not in known:
            raise ModelError(f"{model.name}.{name}", f"no such {what}", f"it has {', '.join(known) or 'none'}")


def _checked(model: Model, name: str, value: Number) -> Number:
    """The value in the variable's own type."""
    variable = model.by_name[name]
    place = f"{model.name}.{name}"
    typed = type(variable.start)(value)  # type: ignore[misc]
    if typed != value or not math.isfinite(typed):
        raise ModelError(place, f"{value} is no {variable.type} value", f"its default is {variable.start}")
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    if not low <= typed <= high:
        raise ModelError(place, f"{value} is outside {low:g} to {high:g}", "give a value within the bounds")
    return typed


def _code(model: Model) -> dict[str, bytes]:
    """Sources, pythonfmu's files and binaries, and the shim, by archive name."""
    source = library.source_file(model)
    modules = {name: (_ROOT / name).read_bytes() for name in _TRAVELS} | {source.name: source.read_bytes()}
    package = f"{model.name}_{_digest(modules)[:12]}"
    files = {f"resources/{package}/{name}": text for name, text in modules.items()}
    files |= {f"resources/{package}/{folder}__init__.py": b"" for folder in ("", "packaging/")}
    shim = f"{package}_slave"
    files[f"resources/{shim}.py"] = _SHIM.format(package=package, module=source.stem).encode()
    files["resources/slavemodule.txt"] = shim.encode()
    home = Path(str(pythonfmu.__file__)).parent
    files |= {f"resources/pythonfmu/{file.name}": file.read_bytes() for file in home.glob("*.py")}
    if not FmuBuilder.has_binary():
        raise ModelError(f"model {model.name}", "pythonfmu has no binary for this platform", "build it natively")
    for binary in (home / "resources" / "binaries").rglob("*.*"):
        if binary.suffix in (".so", ".dll", ".dylib"):
            files[f"binaries/{binary.parent.name}/{model.name}{binary.suffix}"] = binary.read_bytes()
    return files


def _csv(table: Table) -> str:
    rows = (f"{float(time)!r},{float(value)!r}\n" for time, value in zip(table.time, table.values, strict=True))
    return "time,value\n" + "".join(rows)


def _digest(files: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + files[name])
    return digest.hexdigest()
