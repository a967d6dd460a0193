"""An FMU file, checked and unpacked: what it offers, and where its binary lies.

The archive and its XML come from outside: paths, sizes and document types are checked before FMPy reads them.
"""

from __future__ import annotations

import io
import logging
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import fmpy
from fmpy.model_description import InterfaceType, ModelDescription, ModelVariable, read_model_description

from fmus.errors import FmuFileError, ServotwinError
from fmus.files import atomic_write
from fmus.packaging import archive
from fmus.packaging.native import foreign_sources
from fmus.packaging.system import manifest
from fmus.units import Unit
from fmus.words import complaint
from orchestrator.fmi import arrays, definitions, unpacked
from orchestrator.fmi.arrays import LeftOutError, Sizes
from orchestrator.fmi.clocks.declared import adopt_types, amend, clocks
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.processes.memory import require

if TYPE_CHECKING:
    from lxml import etree

LOG = logging.getLogger("servotwin.fmu")
DESCRIPTION = "modelDescription.xml"
LARGEST_DESCRIPTION = 256 << 20
KEPT_DESCRIPTION = 100_000  # bytes up to which what was read is kept for files that say the same
_TRUE = ("true", "1")
TREE = 25  # memory of what is made of a description, by its size


class FmuKind(StrEnum):
    """Interface of an FMU: with its own solver, or for one outside."""

    CO_SIMULATION = "co-simulation"
    MODEL_EXCHANGE = "model exchange"


class FmuDescription:
    """What an FMU says of itself, whether or not there is a binary of it for this platform.

    Args:
        kind: which of its interfaces is meant; None takes co-simulation where it is offered.
        parameters: variable -> value; of these its structural parameters, which give its arrays their shapes.

    Attributes:
        kinds: the interfaces it offers.

    Raises (on reading):
        FmuFileError: no file, no zip, unsafe paths, bad XML, no such interface.
    """

    def __init__(self, path: Path, kind: FmuKind | None = None, parameters: Mapping[str, Value] | None = None) -> None:
        self.path = path
        self.description = read_description(path)
        offers = _offers(self.description)
        self.kinds = tuple(offers)
        self.kind = kind or self.kinds[0]
        if self.kind not in offers:
            raise FmuFileError(path, f"offers no {self.kind}, only {self.kinds[0]}", "remove its `solver`")
        self.offer = offers[self.kind]
        with _guarded(path, DESCRIPTION):
            self.interface = _interface(path, self.description, self.offer, parameters or {})

    @property
    def identifier(self) -> str:
        return str(self.offer.modelIdentifier)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of its continuous states, in the order of their derivatives."""
        return tuple(unknown.variable.derivative.name for unknown in self.description.derivatives)

    @property
    def is_ours(self) -> bool:
        """Whether it says that this project has built it."""
        return bool(self.description.generationTool == "servotwin")


class FmuFile(FmuDescription):
    """An FMU unpacked into a folder; a context manager that lets go of the folder.

    Equal files share a folder, and so their library; one that can be instantiated only once has a folder of its own.
    A library that was compiled from its sources before takes the place of one that it does not bring along.

    Raises (on opening):
        FmuFileError: as its description; or there is no binary for this platform.
    """

    def __init__(self, path: Path, kind: FmuKind | None = None, parameters: Mapping[str, Value] | None = None) -> None:
        super().__init__(path, kind, parameters)
        with _guarded(path, "contents"):
            self.folder = unpacked.take(path, bool(self.offer.canBeInstantiatedOnlyOncePerProcess))
        self._open = True
        try:
            self.require_binary()
            self._of_a_system()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the folder."""
        if self._open:
            self._open = False
            unpacked.give_back(self.folder, again=self.is_ours)

    def __enter__(self) -> FmuFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _of_a_system(self) -> None:
        """Of a system that was made one FMU here, know the base step, for which FMI 2.0 has no word."""
        listed = self.folder / manifest.NAME
        if self.is_ours and listed.is_file():
            inside = manifest.read(f"{self.path}: {manifest.NAME}", listed.read_bytes())
            self.interface = replace(self.interface, fixed_step=inside.base_step)

    def require_binary(self) -> None:
        """See that the folder holds the library; one that was compiled from sources is put there.

        Raises:
            FmuFileError: there is none for this platform.
        """
        if Path(self.identifier).name != self.identifier:
            raise FmuFileError(self.path, f"has the model identifier '{self.identifier}'", "do not trust it")
        modern = self.description.fmiVersion.startswith("3")
        platform = fmpy.platform_tuple if modern else fmpy.platform
        binary = self.folder / "binaries" / platform / (self.identifier + fmpy.sharedLibraryExtension)
        if binary.is_file():
            return
        library = foreign_sources.kept(self.path, self.identifier)
        if library is not None:
            LOG.info("%s: runs the library that was compiled from its sources", self.path)
            atomic_write(binary, library)
            return
        there = sorted(p.name for p in (self.folder / "binaries").glob("*")) or ["none"]
        fix = "export it for this platform"
        with archive.opened(self.path) as zipped:
            brings_sources = foreign_sources.brings(zipped.namelist())
        if brings_sources:
            fix += f", or compile its sources: servotwin build --from-sources {self.path}"
        raise FmuFileError(self.path, f"has no binary for {platform} (it has: {', '.join(there)})", fix)


def read_description(path: Path) -> ModelDescription:
    """modelDescription.xml of an FMU, seen to be of version 2 or 3 and to offer co-simulation or model exchange.

    Raises:
        FmuFileError: see `FmuFile`.
    """
    with _guarded(path, "contents"), archive.opened(path) as zipped:
        try:
            info = zipped.getinfo(DESCRIPTION)
        except KeyError:
            raise FmuFileError(path, f"holds no {DESCRIPTION}", "is it an FMU?") from None
        if info.file_size > LARGEST_DESCRIPTION:
            raise FmuFileError(path, f"has a {DESCRIPTION} over 256 MiB", "do not trust it")
        require(
            path, f"a {DESCRIPTION} of {info.file_size:,} bytes", TREE * info.file_size, "have fewer variables in it"
        )
        text = zipped.read(info)
    parsed = _parsed if len(text) > KEPT_DESCRIPTION else _parsed_once
    description = parsed(_Text(text, path))
    if description.fmiVersion.split(".")[0] not in ("2", "3"):
        raise FmuFileError(path, f"is of FMI version {description.fmiVersion}", "export it for FMI 2.0 or 3.0")
    if not _offers(description):
        raise FmuFileError(path, "offers neither co-simulation nor model exchange", "export it for one of them")
    return description


@dataclass(frozen=True)
class _Text:
    """A description as it is in a file; equal ones are read alike."""

    text: bytes
    path: Path = field(compare=False)


def _parsed(given: _Text) -> ModelDescription:
    root = archive.parse_xml(f"{given.path}: {DESCRIPTION}", given.text)
    with _guarded(given.path, DESCRIPTION):
        definitions.check_places(root)
        description = read_model_description(_alone(_readable(root, given.text)), validate=False)
        _amend(description, root)
    return description


_parsed_once = lru_cache(maxsize=16)(_parsed)


def _readable(root: etree._Element, text: bytes) -> bytes:
    """The description without the types of clocks, which FMPy does not know."""
    return archive.xml_text(root) if adopt_types(root) else text


def _alone(text: bytes) -> io.BytesIO:
    """An archive of the description alone, for FMPy reads archives: whatever else is in one cannot be in its way."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as zipped:
        zipped.writestr(DESCRIPTION, text)
    return made


def _amend(description: ModelDescription, root: etree._Element) -> None:
    """Add what FMPy does not read: directional derivatives of FMI 3, bounds of unsigned integers, start values of
    texts, which units are inverse, which variables differences, how clocks tick, what there is within a step."""
    for tag, offer in (("ModelExchange", description.modelExchange), ("CoSimulation", description.coSimulation)):
        entry = root.find(tag)
        if offer is not None and entry is not None and entry.get("providesDirectionalDerivatives") in ("true", "1"):
            offer.providesDirectionalDerivative = True
    inverse = {shown.get("name") for shown in root.iterfind(".//DisplayUnit") if shown.get("inverse") in ("true", "1")}
    for unit in description.unitDefinitions:
        unit.displayUnits = [shown for shown in unit.displayUnits if shown.name not in inverse]
    amend(description, root)
    within = {one.get("name") for one in root.iterfind("ModelVariables/*") if one.get("intermediateUpdate") in _TRUE}
    for variable in description.modelVariables if within else ():
        variable.intermediateUpdate = variable.name in within
    differences = {
        one.get("name") or one.getparent().get("name"): one.get("relativeQuantity") in _TRUE
        for one in root.iterfind("ModelVariables//*[@relativeQuantity]")
    }
    for variable in description.modelVariables if differences else ():
        variable.relativeQuantity = differences.get((variable.alias or variable).name)
    unsigned = [variable for variable in description.modelVariables if variable.type.startswith("UInt")]
    texts = [variable for variable in description.modelVariables if variable.type == "String" and variable.dimensions]
    if not unsigned and not texts:
        return
    written = {entry.get("valueReference"): entry for entry in root.iterfind("ModelVariables/*")}
    for variable in unsigned:
        entry = written[str(variable.valueReference)]
        variable.min, variable.max = entry.get("min"), entry.get("max")
    for variable in texts:
        starts = written[str(variable.valueReference)].iterfind("Start")
        variable.start = [start.get("value") or "" for start in starts] or None


def _offers(description: ModelDescription) -> dict[FmuKind, InterfaceType]:
    both = {FmuKind.CO_SIMULATION: description.coSimulation, FmuKind.MODEL_EXCHANGE: description.modelExchange}
    return {kind: offer for kind, offer in both.items() if offer is not None}


@contextmanager
def _guarded(path: Path, part: str) -> Iterator[None]:
    """Whatever a broken or hostile file makes zip, XML and FMPy raise ends in one line."""
    try:
        yield
    except ServotwinError:
        raise
    except Exception as error:
        reason = complaint(error)
        if isinstance(error, LookupError):
            reason = f"something that it refers to is not there ({reason})"
        raise FmuFileError(path, f"{part}: {reason}", "ask its supplier for a valid FMU") from error


def _interface(
    path: Path, description: ModelDescription, offer: InterfaceType, parameters: Mapping[str, Value]
) -> Interface:
    fixed = getattr(offer, "fixedInternalStepSize", None)
    units = definitions.units(path, description)
    variables = description.modelVariables
    dimensions = {size.valueReference for variable in variables for size in variable.dimensions}
    wholes = [_port(path, variable, units) for variable in variables]
    sizing = [one for one in wholes if one.causality == "structuralParameter" or one.reference in dimensions]
    sizes = arrays.sizes(path, sizing, parameters)
    ports: dict[str, Port] = {}
    elements: dict[str, list[str]] = {}
    left_out: dict[str, str] = {}
    room = arrays.LARGEST
    for variable, whole in zip(variables, wholes, strict=True):
        if not variable.name:
            problem = f"the variable with the value reference {whole.reference} has no name"
            raise FmuFileError(path, problem, "ask its supplier for a valid FMU")
        definitions.check_variable(path, variable, whole, sizes.declared(variable))
        try:
            found = _ports(variable, whole, sizes, room)
        except LeftOutError as why:
            found, left_out[variable.name] = [], str(why)
        elements[variable.name] = names = [port.name for port in found]
        if twice := next((name for name in names if name in ports), None):
            raise FmuFileError(path, f"two variables are called '{twice}'", "ask its supplier for a valid FMU")
        room -= len(found) if variable.dimensions else 0
        ports.update(zip(names, found, strict=True))
    definitions.check_aliases(path, description, wholes)
    return Interface(
        model_name=description.modelName,
        fmi_version=description.fmiVersion,
        ports=ports,
        feed_through=_feed_through(description, elements),
        has_state=bool(offer.canGetAndSetFMUstate),
        fixed_step=float(fixed) if fixed else None,
        left_out=left_out,
        sizes=sizes.given,
        clocks=clocks(path, description),
        clocked={
            port: frozenset(clock.name for clock in variable.clocks)
            for variable in variables
            if variable.clocks
            for port in elements[variable.name]
        },
        updates=_says(offer, "providesIntermediateUpdate", False),
        intermediate=frozenset(
            name for variable in variables if variable.intermediateUpdate for name in elements[variable.name]
        ),
        variable_step=_says(offer, "canHandleVariableCommunicationStepSize", True),
        event_mode=description.fmiVersion.startswith("3")
        and (offer is description.modelExchange or _says(offer, "hasEventMode", False)),
        doubts=definitions.doubts(description, ports.values()),
    )


def _says(offer: InterfaceType, able: str, otherwise: bool) -> bool:
    """Whether it says that it is able to do something; `otherwise` where its kind has no word for it."""
    return str(getattr(offer, able, otherwise)).lower() in ("true", "1")


def _ports(variable: ModelVariable, port: Port, sizes: Sizes, room: int) -> list[Port]:
    """A scalar's port, or one for each element of an array."""
    if not variable.dimensions:
        return [replace(port, start=str(sizes.given[port.name]))] if port.name in sizes.given else [port]
    starts = variable.start.split() if isinstance(variable.start, str) else variable.start
    if starts is not None and len(starts) > 1 and sizes.resized(variable):
        starts = None
    return list(arrays.elements(port, sizes.shape(variable), starts, room))


def _port(path: Path, variable: ModelVariable, units: Mapping[str, Unit]) -> Port:
    declared = variable.declaredType
    items = {item.name: int(item.value) for item in declared.items} if declared is not None and declared.items else None
    reference, relative = int(variable.valueReference), variable.relativeQuantity
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
        definitions=units,
        exact=variable.start is not None and (variable.initial == "exact" or variable.causality == "input"),
        relative=bool(getattr(declared, "relativeQuantity", False) if relative is None else relative),
    )


def _number(path: Path, variable: ModelVariable, attribute: str) -> float | None:
    text = getattr(variable, attribute)
    if text is None and variable.declaredType is not None:
        text = getattr(variable.declaredType, attribute)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise FmuFileError(f"{path}: {variable.name}", f"{attribute}='{text}' is no number", "correct it") from None


def _feed_through(
    description: ModelDescription, elements: Mapping[str, Sequence[str]]
) -> dict[str, frozenset[str] | None]:
    """Output -> the inputs that act on it at once, of arrays every element on every one."""
    inputs = {variable.name for variable in description.modelVariables if variable.causality == "input"}
    direct: dict[str, frozenset[str] | None] = {
        variable.name: None for variable in description.modelVariables if variable.causality == "output"
    }
    for unknown in description.outputs:
        if unknown.dependencies is not None:
            acting = [known.name for known in unknown.dependencies if known.name in inputs]
            direct[unknown.variable.name] = frozenset(name for whole in acting for name in elements[whole])
    if not inputs:
        direct = dict.fromkeys(direct, frozenset())
    return {name: acting for whole, acting in direct.items() for name in elements[whole]}
