"""A model exchange FMU with every kind of event and of trouble, compiled from `eventful.c`.

It refuses calls out of order, inputs that are set outside event mode, and time that runs backwards.
"""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

TROUBLES = (
    "none",
    "endless",
    "chatter",
    "undefined",
    "discarded",
    "failed",
    "fatal",
    "step event",
    "stop at event",
    "stop at step",
)
_PARAMETERS = {"rate": -1, "gain": 1, "period": 0, "level": 1e300, "after": 0, "nominal": 1, "x_start": 1}
_COUNTERS = ("events", "crossings", "samples", "steps")
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="eventful" guid="eventful" numberOfEventIndicators="1">
  <ModelExchange modelIdentifier="eventful" canGetAndSetFMUstate="true"/>
  <ModelVariables>
    {variables}
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="{index}" dependencies="{dependencies}"/></Outputs>
    <Derivatives><Unknown index="3" dependencies="1 2"/></Derivatives>
  </ModelStructure>
</fmiModelDescription>
"""


def build(folder: Path, output: str = "x") -> Path:
    """The FMU, in this folder, with "x" or "sample" as output; without a C compiler the test is skipped."""
    path = folder / f"eventful_{output}.fmu"
    files = {
        "modelDescription.xml": _description(output).encode(),
        f"binaries/{fmpy.platform}/eventful{SUFFIX}": compiled(Path(__file__).with_suffix(".c")),
    }
    archive.write(path, files)
    return path


def _description(output: str) -> str:
    causalities = {"u": "input", "x": "local", "der(x)": "local", "sample": "local"} | {output: "output"}
    variables = [_real(i, name, causality) for i, (name, causality) in enumerate(causalities.items())]
    variables += [_real(4 + i, name, "parameter", start) for i, (name, start) in enumerate(_PARAMETERS.items())]
    variables.append(_integer(0, "trouble", 'causality="parameter" variability="fixed"', ' start="0"'))
    variables += [_integer(1 + i, name, 'causality="local" variability="discrete"') for i, name in enumerate(_COUNTERS)]
    index, dependencies = ("2", "2") if output == "x" else ("4", "1")
    return _XML.format(variables="\n    ".join(variables), index=index, dependencies=dependencies)


def _real(reference: int, name: str, causality: str, start: float | None = None) -> str:
    variability = {"parameter": "fixed"}.get(causality, "discrete" if name == "sample" else "continuous")
    given = ' start="0"' if causality == "input" else "" if start is None else f' start="{start:g}"'
    derivative = ' derivative="2"' if name == "der(x)" else ""
    return (
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}"><Real{given}{derivative}/></ScalarVariable>'
    )


def _integer(reference: int, name: str, attributes: str, start: str = "") -> str:
    return f'<ScalarVariable name="{name}" valueReference="{reference}" {attributes}><Integer{start}/></ScalarVariable>'
