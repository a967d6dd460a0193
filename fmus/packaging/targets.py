"""From a model to its FMU: the packagings by name, and what was built before from the cache."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache as once
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Protocol

from fmus import library
from fmus.errors import InputError, ModelError
from fmus.files import atomic_write
from fmus.modelling.model import Model, Number, Table
from fmus.packaging import cache, defaults, values
from fmus.packaging.fingerprint import NoFingerprintError, fingerprint
from fmus.packaging.native import compiler, sources
from fmus.packaging.native.network import Network
from fmus.packaging.python import runtime
from fmus.packaging.system.fused import FusedPart, FusedSystem
from fmus.packaging.system.nested import require_libraries

LOG = logging.getLogger("servotwin.build")
NAMES = ("native", "python")
_ROOT = Path(__file__).parents[1]
_BEGAN = time.time()
version = once(metadata.version)  # to look it up takes as long as to open an FMU


def preferred() -> str:
    """The packaging where nobody chose: native where there is a C compiler, else python."""
    return "native" if compiler.available() else "python"


def build(
    model: Model | str | Path,
    path: str | Path,
    *,
    target: str | None = None,
    fmi: int = 2,
    parameters: Mapping[str, Number] | None = None,
    tables: Mapping[str, Table] | None = None,
    platforms: Sequence[str] = ("host",),
    network: Network | None = None,
) -> Path:
    """Write the FMU of a model; the path comes back. One that was built before comes from the cache.

    Args:
        model: a model, the name of one of the library, or a `.py` file that defines MODEL.
        path: the file to write; missing folders are made.
        target: "native" (generated C) or "python" (run by pythonfmu); None takes native where there is a C compiler.
        fmi: 2, or 3 for native FMUs.
        parameters: values of parameters and inputs in place of the model's own, in the units that it declares.
        tables: samples of the tables that the model plays back.
        platforms: of native FMUs "host", "all", or names as x86_64-windows.
        network: the bus that it is on, of native FMUs for FMI 3.

    Raises:
        InputError: the packaging is not known or does not offer what is asked for, or the path cannot be written.
        ModelError: no such model, parameter or table; a value of the wrong type or out of bounds; a model that cannot
            be traced; no compiler, or one that failed.
    """
    order = _Order(
        model if isinstance(model, Model) else library.find(str(model)),
        _offered(target or preferred(), fmi, platforms, network is not None),
        fmi,
        parameters or {},
        tables or {},
        tuple(platforms),
        network,
    )
    return _built(order, Path(path))


def build_system(system: FusedSystem, path: str | Path, *, fmi: int = 2, platforms: Sequence[str] = ("host",)) -> Path:
    """Write the native FMU of a whole system; the path comes back. One that was built before comes from the cache.

    Raises:
        InputError: the path cannot be written.
        ModelError: that version of FMI or platform is not offered, a part's values do not fit its model, a model that
            cannot be turned into C, an FMU without a library for a platform, no compiler, or one that failed.
    """
    _offered("native", fmi, platforms)
    require_libraries(system.nested, compiler.find(platforms))
    return _built(_SystemOrder(system, fmi, tuple(platforms)), Path(path))


class _Made(Protocol):
    """What an FMU is built from."""

    def build(self, path: Path) -> Path:
        """Write the FMU."""

    def key(self) -> str | None:
        """Hash of everything that the FMU is made of, and of what makes it; None where that cannot be known."""


def _built(order: _Made, path: Path) -> Path:
    """The FMU, from the cache where it is there."""
    kept = cache.current()
    key = None if kept is None else order.key()
    if kept is None or key is None:
        return order.build(path)
    content = kept.get(key)
    if content is not None:
        return atomic_write(path, content, for_good=False)
    order.build(path)
    if order.key() == key:  # nothing that it is made of has changed meanwhile
        kept.put(key, path.read_bytes())
    return path


@dataclass(frozen=True)
class _Order:
    """A model, its packaging and its values."""

    model: Model
    target: str
    fmi: int
    parameters: Mapping[str, Number]
    tables: Mapping[str, Table]
    platforms: tuple[str, ...]
    network: Network | None = None

    def build(self, path: Path) -> Path:
        """Trace the model, compile where the packaging is native, and write the FMU."""
        if self.target == "native":
            from fmus.packaging.native import build as native  # noqa: PLC0415 (it brings SymPy along)

            given = self.parameters, self.tables, self.fmi, self.platforms, self.network
            return native.build(self.model, path, *given)
        from fmus.packaging.python import build as python  # noqa: PLC0415 (it brings SymPy along)

        return python.build(self.model, path, self.parameters, self.tables)

    def key(self) -> str | None:
        starts = defaults.dump(values.checked(self.model, self.parameters, self.tables))
        tables = {name: values.csv(table) for name, table in self.tables.items()}
        if self.target == "native":
            parts = _native_parts(self.fmi, self.platforms, self.network)
        else:
            parts = [library.source_file(self.model).read_bytes(), runtime.files(self.model.name)]
        return _key(f"model {self.model.name}", self.target, _told(self.model), starts, tables, parts)


@dataclass(frozen=True)
class _SystemOrder:
    """A system and how it is packaged."""

    system: FusedSystem
    fmi: int
    platforms: tuple[str, ...]

    def build(self, path: Path) -> Path:
        from fmus.packaging.system import build as native  # noqa: PLC0415 (it brings SymPy along)

        return native.build(self.system, path, self.fmi, self.platforms)

    def key(self) -> str | None:
        system = self.system
        made = [(name, part.model, _starts_of(part), part.every, part.instant) for name, part in system.models.items()]
        parts = [[*system.parts], made, system.nested]
        wires = [(wire.source, wire.target, wire.factor, wire.offset) for wire in system.wires]
        times = [str(time) for time in (system.base, system.start, system.stop, system.step)]
        shown = (system.name, system.description, system.outputs, system.parameters, system.finite, system.tolerance)
        native = _native_parts(self.fmi, self.platforms)
        return _key(f"system {system.name}", "system", parts, wires, times, shown, native)


def _told(model: Model) -> Model | str:
    """What stands for a model in a key: of one of the library, which nobody changes, its hash."""
    if library.file_of(model.name) is not None and library.find(model.name) is model:
        with suppress(NoFingerprintError):
            return _of_library(model.name)
    return model


@once
def _of_library(name: str) -> str:
    return fingerprint(library.find(name))


def _starts_of(part: FusedPart) -> tuple[str, dict[str, bytes]]:
    """A part's values and tables as they travel in an FMU."""
    starts = defaults.dump(values.checked(part.model, part.values, part.tables))
    return starts, {name: values.csv(table) for name, table in part.tables.items()}


def _native_parts(fmi: int, platforms: Sequence[str], network: Network | None = None) -> list[object]:
    """What native FMUs are made of beside their models."""
    machines = [(machine.name, compiler.identity(machine)) for machine in compiler.find(platforms)]
    return [_fixed(fmi, network is not None), machines, network]


@once
def _fixed(fmi: int, networked: bool) -> str:
    """Hash of the C code that all native FMUs have."""
    return fingerprint(sources.fixed(fmi, networked))


def _key(what: str, *parts: object) -> str | None:
    """Hash of these parts and of what makes an FMU of them; None where that cannot be known.

    That is so for a model whose functions hold objects, and once the files of the project have changed since this
    process began: what it would build comes from what it has loaded.
    """
    stamps = _stamps()
    if any(changed > _BEGAN * 1e9 for _, changed, _ in stamps):
        return None
    try:
        return fingerprint(sys.version, version("sympy"), _code(stamps), *parts)
    except NoFingerprintError as problem:
        LOG.info("%s is not kept in the cache: it holds %s", what, problem)
        return None


def read_ahead() -> None:
    """Read what each lookup in the cache of built FMUs needs, for processes that are forked from this one."""
    for fmi in sources.VERSIONS:
        _fixed(fmi, False)
    for name in library.names():
        _told(library.find(name))
    _code(_stamps())
    version("sympy")


def _stamps() -> tuple[tuple[Path, int, int], ...]:
    """The project's files with when they were changed last [ns] and their sizes [bytes]."""
    return tuple((file, (found := file.stat()).st_mtime_ns, found.st_size) for file in _own_files(_ROOT))


@once
def _own_files(root: Path) -> tuple[Path, ...]:
    """The project's code that FMUs are made of, without the models: those are in memory."""
    files = (file for file in root.rglob("*") if file.suffix in (".py", ".c", ".h", ".txt", ".png", ".svg"))
    return tuple(sorted(file for file in files if root / "models" not in file.parents or file.name == "__init__.py"))


@lru_cache(maxsize=1)
def _code(stamps: tuple[tuple[Path, int, int], ...]) -> str:
    """Hash of the names and contents of these files."""
    return fingerprint([(str(file.relative_to(_ROOT)), file.read_bytes()) for file, _, _ in stamps])


def _offered(target: str, fmi: int, platforms: Sequence[str], networked: bool = False) -> str:
    """The packaging, once it is seen to offer what is asked for."""
    if networked and (target, fmi) != ("native", 3):
        raise InputError("a network FMU", f"is not FMI {fmi} by target '{target}'", "use --target native --fmi 3")
    if target not in NAMES:
        raise InputError(f"target '{target}'", "is not known", f"choose {' or '.join(NAMES)}")
    if target == "python" and (fmi != 2 or tuple(platforms) != ("host",)):
        raise InputError("target 'python'", "is FMI 2 and for every platform at once", "use --target native")
    if fmi not in sources.VERSIONS:
        raise ModelError(f"target '{target}'", f"FMI {fmi} is not offered", "choose FMI 2 or 3")
    return target
