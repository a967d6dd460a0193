"""Native FMUs: C generated from the model file, a small runtime, and nothing else needed where they run.

The binary checks the first part of the FMU's GUID or token, which stands for its code; the rest stands for the
defaults it was built with, so that FMUs of one model with other values are not taken for each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.modelling.agreement import require_agreement
from fmus.modelling.model import Model, Number, Table
from fmus.packaging import archive, defaults, licenses, values
from fmus.packaging.description import documentation, exposure, interface, terminals, xml
from fmus.packaging.description.interface import ModelInterface
from fmus.packaging.description.xml import Extras, Offer
from fmus.packaging.native import c_model, c_network, compiler, network_files, sources
from fmus.packaging.native.capabilities import CAPABILITIES, NETWORKED
from fmus.packaging.native.compiler import Platform
from fmus.packaging.native.network import Network

LOG_CATEGORIES = xml.LOG_CATEGORIES | {"logEvents": "What was read, and how the model is stepped"}


def build(
    model: Model,
    path: Path,
    parameters: Mapping[str, Number] | None = None,
    tables: Mapping[str, Table] | None = None,
    fmi: int = 2,
    platforms: Sequence[str] = ("host",),
    network: Network | None = None,
) -> Path:
    """Write the FMU of a model with these defaults and tables; the path comes back.

    Co-simulation for every model, model exchange too for those with continuous states and no sampled ones, and no
    network.

    Args:
        fmi: 2 or 3.
        platforms: names of `compiler.PLATFORMS`, "host" or "all".
        network: the bus that it is on, with FMI 3.

    Raises:
        ModelError: a parameter or table the model does not have, a value of the wrong type or out of bounds, a model
            that cannot be turned into C, no compiler, or one that failed.
    """
    model = model if network is None else network_files.notified(model)
    starts = values.checked(model, parameters or {}, tables or {})
    shown = _shown(model, starts, network)
    code = _code(model, fmi, network)
    resources = {f"resources/{name}.csv": values.csv(table) for name, table in (tables or {}).items()}
    resources[defaults.RESOURCE] = defaults.dump(starts).encode()
    files = resources | compiled(model.name, code, fmi, compiler.find(platforms))
    files["modelDescription.xml"] = _description(
        shown, f"{code.token}-{archive.digest(resources)[:16]}", fmi, code, network
    )
    files["documentation/index.html"] = documentation.page(shown)
    files |= terminals.files(shown, fmi, None if network is None else network_files.terminal(network))
    files |= {} if network is None else network_files.files(network)
    archive.write(path, files)
    return path


@dataclass(frozen=True)
class Code:
    """C sources by file name, and the token that stands for them."""

    sources: Mapping[str, str]
    token: str

    @property
    def units(self) -> list[str]:
        return [name for name in sorted(self.sources) if name.endswith(".c")]


@cache
def _code(model: Model, fmi: int, network: Network | None = None) -> Code:
    """Generated sources, runtime and FMI headers; what they are does not depend on parameters."""
    fixed = sources.fixed(fmi, network is not None)
    require_agreement(model)
    shown = _shown(model, {}, network)
    generated = c_model.generate(shown, "")
    if network is not None:
        references = {variable.name: variable.reference for variable in shown.variables}
        generated[c_network.HEADER] = c_network.tables(network, references, shown.time_reference + 1)
    digest = archive.digest({name: text.encode() for name, text in (fixed | generated).items()})
    token = f"{model.name}-{digest[:32]}"
    return Code(fixed | generated | {"layout.h": c_model.layout(shown, token)}, token)


def _shown(model: Model, starts: Mapping[str, Number], network: Network | None) -> ModelInterface:
    """What the FMU shows."""
    shown = exposure.complete(model, starts)
    return shown if network is None else shown.on_a_bus(network.received)


def compiled(
    name: str, code: Code, fmi: int, platforms: Sequence[Platform], flags: Sequence[str] = ()
) -> dict[str, bytes]:
    """Sources, what they are compiled to, and their license, by archive name."""
    files = {f"sources/{file}": text.encode() for file, text in code.sources.items()}
    files |= _binaries(name, code, fmi, platforms, flags) | {licenses.NAME: licenses.native()}
    return files | ({"sources/buildDescription.xml": _build_description(name, code)} if fmi == 3 else {})


def _binaries(name: str, code: Code, fmi: int, platforms: Sequence[Platform], flags: Sequence[str]) -> dict[str, bytes]:
    """Libraries by archive name; FMI 2.0 has one folder for the two processors of macOS, so they share a file."""
    found: dict[str, dict[str, bytes]] = {}
    for target in platforms:
        folder = target.folder2 if fmi == 2 else target.name
        path = f"binaries/{folder}/{name}{target.suffix}"
        found.setdefault(path, {})[target.name] = compiler.compile_library(code.sources, name, target, flags)
    return {
        path: next(iter(parts.values())) if len(parts) == 1 else compiler.universal(parts)
        for path, parts in found.items()
    }


def _description(shown: ModelInterface, token: str, fmi: int, code: Code, network: Network | None) -> bytes:
    model = shown.model
    flags = CAPABILITIES[fmi] if network is None else NETWORKED
    exchangeable = interface.exchangeable(model) and network is None
    common = {**flags.common, **dict.fromkeys(flags.derivatives, exchangeable)}
    listed = code.units if fmi == 2 else []
    clock = fmi == 3 and network is None and interface.clocked(model)
    stepping = {"canHandleVariableCommunicationStepSize": True}
    stepping |= {"hasEventMode": True} if clock or network is not None else {}
    offers = [Offer("ModelExchange", model.name, common | flags.exchange, listed)] if exchangeable else []
    offers.append(Offer("CoSimulation", model.name, common | stepping, listed))
    starts = {v.name: v.start for v in shown.variables if v.start is not None}
    extras = Extras(LOG_CATEGORIES, interface.default_step(model, starts))
    if clock:
        extras = replace(extras, variables=[xml.clock(shown)])
    if network is not None:
        first = shown.time_reference + 1
        extras = replace(extras, variables=network_files.variables(network, first), outputs=[first + 1])
    return (xml.fmi2 if fmi == 2 else xml.fmi3)(shown, token, offers, extras)


def _build_description(name: str, code: Code) -> bytes:
    """buildDescription.xml of FMI 3.0: how the sources of an FMU of this name are compiled."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for file in code.units:
        ET.SubElement(files, "SourceFile", name=file)
    return xml.document(root)
