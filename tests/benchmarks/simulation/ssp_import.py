"""How long it takes to make a system of an SSP with 200 FMUs, all different, and 5,000 connections."""

from __future__ import annotations

import subprocess
import sys
import time
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.modelling.model import Model, input_, output, parameter
from fmus.packaging import archive, targets
from orchestrator.assembly.assembly import link
from orchestrator.assembly.wiring import wire
from orchestrator.fmi.file import FmuDescription
from orchestrator.ssp.document import imported
from orchestrator.system import Part
from tests.support.simulation import ssps

from ..figure import Figure

ROOT = Path(__file__).parents[3]
FMUS, PORTS, CONNECTIONS, LIMIT = 200, 25, 5000, 5.0


def _model() -> Model:
    """25 inputs and outputs."""
    return Model(
        name="many",
        description="Many gains",
        variables=(
            *(input_(f"u{n}", "1", "In", start=0.0) for n in range(PORTS)),
            *(output(f"y{n}", "1", "Out") for n in range(PORTS)),
            parameter("k", "1", 0.5, "Factor"),
        ),
        outputs=lambda t, x, u, p: {f"y{n}": p.k * getattr(u, f"u{n}") for n in range(PORTS)},
    )


def large(path: Path) -> Path:
    """The SSP: each FMU drives the next one."""
    contents = archive.read(targets.build(_model(), path.with_suffix(".fmu")))
    components, links = [], []
    kinds = {f"u{n}": "input" for n in range(PORTS)} | {f"y{n}": "output" for n in range(PORTS)}
    ports = ssps.connectors(**kinds)
    with zipfile.ZipFile(path, "w") as made:
        for number in range(FMUS):
            file = path.with_name("one.fmu")
            archive.write(file, {**contents, "documentation/number": str(number).encode()})
            made.write(file, f"resources/f{number}.fmu")
            inner = ssps.bindings(ssps.values({"k": ssps.real(0.5)}))
            source = f'source="resources/f{number}.fmu"'
            components.append(f'<ssd:Component name="c{number}" {source}>{ports}{inner}</ssd:Component>')
            links += [ssps.connection(f"c{number}.y{n}", f"c{(number + 1) % FMUS}.u{n}") for n in range(PORTS)]
        assert len(links) == CONNECTIONS
        described = ssps.described(ssps.system(components, links))
        made.writestr("SystemStructure.ssd", described)
    return path


def figures() -> list[Figure]:
    """The processor time from the file to the wired system; the least of three."""
    with TemporaryDirectory() as place:
        path = large(Path(place) / "large.ssp")
        taken = min(_seconds(path) for _ in range(3))
    return [
        Figure(
            f"{FMUS} FMUs and {CONNECTIONS:,} connections of an SSP to a wired system: processor time",
            f"under {LIMIT:g} s",
            f"{taken:.2f} s",
            taken < LIMIT,
        )
    ]


def _seconds(path: Path) -> float:
    """Of an import in a process that has none of it unpacked."""
    program = "import sys\nfrom tests.benchmarks.simulation.ssp_import import timed\nprint(timed(sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", program, path], check=True, capture_output=True, text=True, cwd=ROOT)
    return float(done.stdout)


def timed(path: str) -> float:
    """Processor time to the wired system, whose names, types and units all fit [s]."""
    begun = time.process_time()
    document = imported(Path(path)).document
    parts = {name: Part(FmuDescription(Path(one["fmu"])).interface) for name, one in document["components"].items()}
    system = wire(parts, map(link, document["connections"]))
    taken = time.process_time() - begun
    assert (len(system.parts), len(system.connections)) == (FMUS, CONNECTIONS)
    return taken
