"""SSPs as other tools write them, around small FMUs that are built here."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from fmus.modelling.model import Model, input_, output, parameter
from fmus.packaging import targets

NAMESPACES = {
    prefix: f"http://ssp-standard.org/SSP1/SystemStructure{name}"
    for prefix, name in {
        "ssd": "Description",
        "ssc": "Common",
        "ssv": "ParameterValues",
        "ssm": "ParameterMapping",
        "ssb": "SignalDictionary",
    }.items()
}
XMLNS = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in NAMESPACES.items())


@cache
def gain(unit: str = "1", out: str | None = None) -> Path:
    """y = k u + b and n, m, on beside it; u and b in a unit, y in that or another."""
    model = Model(
        name="gain",
        description="A gain",
        variables=(
            input_("u", unit, "What comes in", start=1.0),
            output("y", out or unit, "What goes out"),
            parameter("k", "1", 2.0, "Factor"),
            parameter("b", unit, 0.0, "Offset"),
            parameter("n", "1", 3, "A whole number"),
            parameter("on", "1", True, "Whether it is on"),
            parameter("mode", "1", 1, "Which", choices=("slow", "fast")),
        ),
        outputs=lambda t, x, u, p: {"y": p.k * u.u + p.b + 0.0 * p.n},
    )
    return targets.build(model, Path(mkdtemp(prefix="servotwin-test-")) / "gain.fmu")


def archive(path: Path, system: str, files: Mapping[str, Path | str] | None = None, version: str = "1.0") -> Path:
    """An SSP with a description around `system`, and files by name; by default the gain as `resources/gain.fmu`."""
    description = described(system, version) if system.startswith("<ssd:System ") else system
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("SystemStructure.ssd", description)
        for name, content in ({"resources/gain.fmu": gain()} if files is None else files).items():
            made.writestr(name, content.read_bytes() if isinstance(content, Path) else content)
    return path


def described(system: str, version: str = "1.0") -> str:
    """The description around a system."""
    head = f'<ssd:SystemStructureDescription {XMLNS} version="{version}" name="foreign">'
    return f'{head}{system}<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>'


def component(name: str, source: str = "resources/gain.fmu", inner: str = "", units: str = "") -> str:
    """A gain with its connectors."""
    connectors = "".join(
        f'<ssd:Connector name="{key}" kind="{kind}"><ssc:Real{units}/></ssd:Connector>'
        for key, kind in {"u": "input", "y": "output", "k": "parameter"}.items()
    )
    inside = f"<ssd:Connectors>{connectors}</ssd:Connectors>{inner}"
    return f'<ssd:Component name="{name}" source="{source}">{inside}</ssd:Component>'


def connection(start: str, end: str, inner: str = "", more: str = "") -> str:
    """One between `element.connector`s, or connectors of the system."""
    ends = ""
    for side, name in (("start", start), ("end", end)):
        element, dot, connector = name.rpartition(".")
        ends += f' {side}Element="{element}"' if dot else ""
        ends += f' {side}Connector="{connector}"'
    return f"<ssd:Connection{ends} {more}>{inner}</ssd:Connection>"


def system(
    elements: Iterable[str], connections: Iterable[str] = (), name: str = "top", before: str = "", after: str = ""
) -> str:
    """A system of these."""
    links = "".join(connections)
    joined = f"<ssd:Connections>{links}</ssd:Connections>" if links else ""
    inside = f"{before}<ssd:Elements>{''.join(elements)}</ssd:Elements>{joined}{after}"
    return f'<ssd:System name="{name}">{inside}</ssd:System>'


def connectors(**kinds: str) -> str:
    """Connectors of a system: name -> kind, all of real numbers."""
    entries = (f'<ssd:Connector name="{n}" kind="{kind}"><ssc:Real/></ssd:Connector>' for n, kind in kinds.items())
    return f"<ssd:Connectors>{''.join(entries)}</ssd:Connectors>"


def values(given: Mapping[str, str], units: str = "", name: str = "set") -> str:
    """A parameter set: name -> the element of its value, `<ssv:Real value="2"/>`."""
    entries = "".join(f'<ssv:Parameter name="{key}">{value}</ssv:Parameter>' for key, value in given.items())
    inside = f"<ssv:Parameters>{entries}</ssv:Parameters>{units}"
    return f'<ssv:ParameterSet {XMLNS} version="1.0" name="{name}">{inside}</ssv:ParameterSet>'


def real(value: float, unit: str = "") -> str:
    return f'<ssv:Real value="{value!r}"{f" unit={chr(34)}{unit}{chr(34)}" if unit else ""}/>'


def bindings(*sets: str) -> str:
    """Bindings of parameter sets, inline."""
    inner = "".join(
        f"<ssd:ParameterBinding><ssd:ParameterValues>{one}</ssd:ParameterValues></ssd:ParameterBinding>" for one in sets
    )
    return f"<ssd:ParameterBindings>{inner}</ssd:ParameterBindings>"
