"""A system's FMU: the generated C of its models and of their wiring in one library, for co-simulation.

FMUs that are parts of it lie unpacked in its resources.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.modelling.agreement import require_agreement
from fmus.modelling.model import Number
from fmus.packaging import archive, defaults, values
from fmus.packaging.description import terminals, xml
from fmus.packaging.description.xml import Extras, Offer
from fmus.packaging.native import compiler
from fmus.packaging.native.build import LOG_CATEGORIES, Code, compiled
from fmus.packaging.native.capabilities import CAPABILITIES
from fmus.packaging.system import c_system, manifest, nested, page
from fmus.packaging.system.fused import FusedSystem
from fmus.packaging.system.interface import SystemInterface, shown

FLAGS = ("-O3",)  # equations and runtime of a model lie in one file: it pays to have them inlined


def build(system: FusedSystem, path: Path, fmi: int = 2, platforms: Sequence[str] = ("host",)) -> Path:
    """Write the FMU of a system; the path comes back.

    Args:
        fmi: 2 or 3.
        platforms: names of `compiler.PLATFORMS`, "host" or "all".

    Raises:
        ModelError: a part's values do not fit its model, a model that cannot be turned into C, an FMU without a library
            for a platform, no compiler, or one that failed.
    """
    machines = compiler.find(platforms)
    held = nested.resources(system.nested, machines)
    interface = shown(system)
    code = _code(interface, fmi)
    resources = {
        f"resources/{name}/{table}.csv": values.csv(samples)
        for name, part in system.parts.items()
        for table, samples in part.tables.items()
    }
    resources |= held
    resources[defaults.RESOURCE] = defaults.dump(_starts(interface)).encode()
    files = resources | compiled(system.name, code, fmi, machines, FLAGS)
    shows = "\n".join(interface.by_name).encode()  # what importers may know it by, whatever its binary does
    identity = f"{code.token}-{archive.digest(resources | {'shows': shows})[:16]}"
    files["modelDescription.xml"] = _description(interface, identity, fmi, code)
    files |= terminals.files(interface, fmi)
    files["documentation/index.html"] = page.page(interface)
    files[manifest.NAME] = manifest.written(system)
    archive.write(path, files)
    return path


def _code(interface: SystemInterface, fmi: int) -> Code:
    for model in {one.model: None for one in interface.models.values()}:
        require_agreement(model)
    sources = c_system.generate(interface, fmi)
    whole = sources | {"layout.h": c_system.layout(interface, "")}
    digest = archive.digest({name: text.encode() for name, text in whole.items()})
    token = f"{interface.name}-{digest[:32]}"
    return Code(sources | {"layout.h": c_system.layout(interface, token)}, token)


def _starts(interface: SystemInterface) -> dict[str, float]:
    """What the FMU has as defaults: of models all inputs that nothing drives and all parameters, seen or not; of FMUs
    what is set in them."""
    given = {f"{name}.{key}" for name, part in interface.system.nested.items() for key in part.values}
    return {
        variable.name: variable.start
        for part, own in interface.inside.items()
        for variable in own
        if variable.causality in ("input", "parameter") and variable.name not in interface.sources
        if variable.start is not None and (part in interface.models or variable.name in given)
    }


def _description(interface: SystemInterface, token: str, fmi: int, code: Code) -> bytes:
    system, flags = interface.system, CAPABILITIES[fmi]
    able: dict[str, Number] = {
        **flags.common,
        **dict.fromkeys(flags.derivatives, False),
        "canHandleVariableCommunicationStepSize": True,
    }
    able |= _with_fmus(system, able)
    stepping = {"fixedInternalStepSize": float(system.base)} if fmi == 3 else {}
    offers = [Offer("CoSimulation", interface.name, able | stepping, code.units if fmi == 2 else [])]
    extras = Extras(LOG_CATEGORIES, float(system.step), float(system.start), float(system.stop))
    return (xml.fmi2 if fmi == 2 else xml.fmi3)(interface, token, offers, extras)


def _with_fmus(system: FusedSystem, able: Mapping[str, Number]) -> dict[str, Number]:
    """What a system with FMUs inside can and cannot by them."""
    parts = system.nested.values()
    going_back = [name for name in able if name.startswith("canGetAndSet") and not all(part.saves for part in parts)]
    serial = [name for name in able if name.startswith("canSerialize") and parts]
    changed: dict[str, Number] = dict.fromkeys([*going_back, *serial], False)
    if any(part.once for part in parts):
        changed["canBeInstantiatedOnlyOncePerProcess"] = True
    return changed | ({"needsExecutionTool": True} if any(part.needs_tool for part in parts) else {})
