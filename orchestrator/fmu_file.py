"""An FMU file, checked and unpacked: what it offers, and where its binary lies.

The archive and its XML come from outside: paths, sizes and document types are checked before FMPy reads them.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import fmpy
from fmpy.model_description import ModelDescription, ModelVariable, read_model_description

from fmus.errors import FmuFileError, ServotwinError
from fmus.packaging import archive
from orchestrator.interrupts import UNPACKED

LARGEST_DESCRIPTION = 256 << 20
_NO_NUMBER = ("String", "Binary", "Clock")


@dataclass(frozen=True)
class Port:
    """A scalar variable of an FMU.

    Attributes:
        type: FMI type name ("Real", "Float64", "Integer", "Int32", "Boolean", "Enumeration", "String", ...).
        variability: "constant", "fixed", "tunable", "discrete" or "continuous".
        start: start value as the file gives it, None without one.
        items: name -> value of an enumeration.
    """

    name: str
    reference: int
    type: str
    causality: str
    unit: str | None = None
    start: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    items: Mapping[str, int] | None = None
    description: str = ""
    variability: str = "continuous"

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers (or true and false), so that they can be connected and recorded."""
        return self.type not in _NO_NUMBER

    @property
    def settable(self) -> bool:
        """Whether it can be given a value before a run: parameters, inputs, and states with a start value."""
        causes = ("parameter", "input", "local", "output")
        return self.causality in causes and self.variability != "constant" and self.start is not None


@dataclass(frozen=True)
class Interface:
    """What a component offers to a system.

    Attributes:
        ports: name -> scalar variable.
        feed_through: output -> the inputs that act on it at once; None where the FMU does not say.
    """

    model_name: str
    fmi_version: str
    ports: Mapping[str, Port]
    feed_through: Mapping[str, frozenset[str] | None]
    has_state: bool = False
    fixed_step: float | None = None
    variable_step: bool = True

    def of(self, causality: str) -> tuple[Port, ...]:
        """Ports of one causality."""
        return tuple(port for port in self.ports.values() if port.causality == causality)


class FmuFile:
    """An FMU unpacked into a folder of its own; a context manager that removes the folder.

    Raises (on opening):
        FmuFileError: no file, no zip, unsafe paths, bad XML, no co-simulation, no binary for this platform.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.description = read_description(path)
        with _guarded(path, "modelDescription.xml"):
            self.interface = _interface(path, self.description)
        self.folder = Path(tempfile.mkdtemp(prefix=UNPACKED))
        try:
            with _guarded(path, "contents"), archive.opened(path) as zipped:
                zipped.extractall(self.folder)
            self._require_binary()
        except BaseException:
            self.close()
            raise

    @property
    def identifier(self) -> str:
        return str(self.description.coSimulation.modelIdentifier)

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> FmuFile:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _require_binary(self) -> None:
        if Path(self.identifier).name != self.identifier:
            raise FmuFileError(self.path, f"has the model identifier '{self.identifier}'", "do not trust it")
        modern = self.description.fmiVersion.startswith("3")
        platform = fmpy.platform_tuple if modern else fmpy.platform
        binary = self.folder / "binaries" / platform / (self.identifier + fmpy.sharedLibraryExtension)
        if not binary.is_file():
            there = sorted(p.name for p in (self.folder / "binaries").glob("*")) or ["none"]
            raise FmuFileError(self.path, f"has no binary for {platform} (it has: {', '.join(there)})",
                               "export it for this platform")  # fmt: skip


def read_description(path: Path) -> ModelDescription:
    """modelDescription.xml of an FMU, seen to be a co-simulation FMU of version 2 or 3.

    Raises:
        FmuFileError: see `FmuFile`.
    """
    with _guarded(path, "contents"), archive.opened(path) as zipped:
        try:
            info = zipped.getinfo("modelDescription.xml")
        except KeyError:
            raise FmuFileError(path, "holds no modelDescription.xml", "is it an FMU?") from None
        if info.file_size > LARGEST_DESCRIPTION:
            raise FmuFileError(path, "has a modelDescription.xml over 256 MiB", "do not trust it")
        archive.parse_xml(f"{path}: modelDescription.xml", zipped.read(info))
    with _guarded(path, "modelDescription.xml"):
        description = read_model_description(str(path), validate=False)
    if description.fmiVersion.split(".")[0] not in ("2", "3"):
        raise FmuFileError(path, f"is of FMI version {description.fmiVersion}", "export it for FMI 2.0 or 3.0")
    if description.coSimulation is None:
        raise FmuFileError(path, "offers no co-simulation", "export it for co-simulation")
    return description


@contextmanager
def _guarded(path: Path, part: str) -> Iterator[None]:
    """Whatever a broken or hostile file makes zip, XML and FMPy raise ends in one line."""
    try:
        yield
    except ServotwinError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FmuFileError(path, f"{part}: {reason[:300]}", "ask its supplier for a valid FMU") from error


def _interface(path: Path, description: ModelDescription) -> Interface:
    cs = description.coSimulation
    scalars = [variable for variable in description.modelVariables if not variable.dimensions]
    ports = {variable.name: _port(path, variable) for variable in scalars}
    if len(ports) != len(scalars):
        raise FmuFileError(path, "two variables have one name", "ask its supplier for a valid FMU")
    return Interface(
        model_name=description.modelName,
        fmi_version=description.fmiVersion,
        ports=ports,
        feed_through=_feed_through(description),
        has_state=bool(cs.canGetAndSetFMUstate),
        fixed_step=float(cs.fixedInternalStepSize) if cs.fixedInternalStepSize else None,
        variable_step=bool(cs.canHandleVariableCommunicationStepSize),
    )


def _port(path: Path, variable: ModelVariable) -> Port:
    declared = variable.declaredType
    items = {item.name: int(item.value) for item in declared.items} if declared is not None and declared.items else None
    reference = int(variable.valueReference)
    if not 0 <= reference < 1 << 32:
        raise FmuFileError(f"{path}: {variable.name}", f"has the value reference {reference}", "correct it")
    return Port(
        name=variable.name,
        reference=reference,
        type=variable.type,
        causality=variable.causality or "local",
        unit=variable.unit or (declared.unit if declared is not None else None),
        start=variable.start,
        minimum=_number(path, variable, "min"),
        maximum=_number(path, variable, "max"),
        items=items,
        description=variable.description or "",
        variability=variable.variability or "continuous",
    )


def _number(path: Path, variable: ModelVariable, attribute: str) -> float | None:
    text = getattr(variable, attribute)
    if text is None and variable.declaredType is not None:
        text = getattr(variable.declaredType, attribute)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise FmuFileError(f"{path}: {variable.name}", f"{attribute}='{text}' is no number", "correct it") from None


def _feed_through(description: ModelDescription) -> dict[str, frozenset[str] | None]:
    inputs = {variable.name for variable in description.modelVariables if variable.causality == "input"}
    direct: dict[str, frozenset[str] | None] = {
        variable.name: None for variable in description.modelVariables if variable.causality == "output"
    }
    for unknown in description.outputs:
        if unknown.dependencies is not None:
            direct[unknown.variable.name] = frozenset(each.name for each in unknown.dependencies) & inputs
    if not inputs:
        return dict.fromkeys(direct, frozenset())
    return direct
