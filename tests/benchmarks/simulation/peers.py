"""The ring of five FMUs in other tools, each in a process of its own: `python peers.py TOOL FMU COUNT STEPS REPEATS`.

Prints the seconds of each repetition, from the first step to the last, as one JSON list. Stands alone: CoFmuPy needs
an environment of its own, since it pins an older FMPy.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

STEP = 1e-3  # [s]
INPUT, OUTPUT = "Float64_continuous_input", "Float64_continuous_output"
REFERENCES = {INPUT: 7, OUTPUT: 8}
REALS, INTEGERS, BOOLEANS = [8, 10], [20, 34], [28]

Ring = Callable[[Path, int, int], float]


def ring(count: int) -> Iterator[tuple[int, int]]:
    """(from, to) of each connection."""
    return ((number, (number + 1) % count) for number in range(count))


def ecos(fmu: Path, count: int, steps: int, csv: bool = False, read: bool = False) -> float:
    """Seconds of ecos."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        for number in range(count):
            structure.add_model(f"c{number}", str(fmu))
        for source, target in ring(count):
            structure.make_real_connection(f"c{source}::{OUTPUT}", f"c{target}::{INPUT}")
        with EcosSimulation(step_size=STEP, structure=structure) as simulation:
            if csv:
                simulation.add_csv_writer("ecos.csv")
            simulation.init()
            rows = []
            begun = perf_counter()
            for _ in range(steps if read else 1):
                simulation.step(1 if read else steps)
                if read:
                    rows.append([simulation.get_real(f"c{number}::{OUTPUT}") for number in range(count)])
            taken = perf_counter() - begun
            simulation.terminate()
            return taken


def ecos_csv(fmu: Path, count: int, steps: int) -> float:
    """Seconds of ecos with its CSV writer."""
    return ecos(fmu, count, steps, csv=True)


def ecos_read(fmu: Path, count: int, steps: int) -> float:
    """Seconds of ecos when the outputs that drive the ring are read at each step."""
    return ecos(fmu, count, steps, read=True)


def libcosim(fmu: Path, count: int, steps: int, observer: bool = False) -> float:
    """Seconds of libcosim."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(STEP * 1e9)
    slaves = [CosimLocalSlave(str(fmu), f"c{number}") for number in range(count)]
    numbers = [execution.add_local_slave(slave) for slave in slaves]
    for source, target in ring(count):
        execution.connect_real_variables(numbers[source], REFERENCES[OUTPUT], numbers[target], REFERENCES[INPUT])
    if observer:
        execution.add_observer(CosimObserver.create_to_dir("."))
    execution.step(1)  # initialises
    begun = perf_counter()
    if not execution.step(steps):
        raise RuntimeError("libcosim failed")
    return perf_counter() - begun


def libcosim_observer(fmu: Path, count: int, steps: int) -> float:
    """Seconds of libcosim with its file observer."""
    return libcosim(fmu, count, steps, observer=True)


def fmpy_loop(fmu: Path, count: int, steps: int) -> float:
    """Seconds of a loop over FMPy's slaves that keeps every output."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    description = fmpy.read_model_description(str(fmu))
    folder = fmpy.extract(str(fmu), tempfile.mkdtemp(dir=Path.cwd()))
    slaves = []
    for number in range(count):
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            instanceName=f"c{number}",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slaves.append(slave)
    outputs = [slave.getReal(REALS) for slave in slaves]
    rows = []
    begun = perf_counter()
    for step in range(steps):
        before = [values[0] for values in outputs]
        row: list[float] = []
        for number, slave in enumerate(slaves):
            slave.setReal([REFERENCES[INPUT]], [before[number - 1]])
            slave.doStep(step * STEP, STEP)
            outputs[number] = slave.getReal(REALS)
            row += outputs[number]
            row += slave.getInteger(INTEGERS)
            row += slave.getBoolean(BOOLEANS)
        rows.append(row)
    return perf_counter() - begun


def cofmupy(fmu: Path, count: int, steps: int) -> float:
    """Seconds of CoFmuPy, which keeps every output."""
    from cofmupy import Coordinator

    def end(number: int, variable: str) -> dict[str, str]:
        return {"id": f"c{number}", "variable": variable, "unit": "", "type": "fmu"}

    config = {
        "fmus": [{"id": f"c{number}", "path": str(fmu), "initialization": {}} for number in range(count)],
        "connections": [{"source": end(i, OUTPUT), "target": end(j, INPUT)} for i, j in ring(count)],
        "cosim_method": "jacobi",
        "iterative": False,
        "edge_sep": " -> ",
        "root": "",
    }
    Path("ring.json").write_text(json.dumps(config))
    coordinator = Coordinator()
    coordinator.start("ring.json")
    begun = perf_counter()
    for _ in range(steps):
        coordinator.do_step(STEP)
    return perf_counter() - begun


TOOLS: dict[str, Ring] = {
    each.__name__: each for each in (ecos, ecos_csv, ecos_read, libcosim, libcosim_observer, fmpy_loop, cofmupy)
}


def main(tool: str, fmu: str, count: str, steps: str, repeats: str) -> None:
    """Measure in a folder of its own; what the tool prints goes to standard error."""
    answer = os.dup(1)
    os.dup2(2, 1)
    path = Path(fmu).resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        taken = [TOOLS[tool](path, int(count), int(steps)) for _ in range(int(repeats))]
        os.chdir("/")
    os.write(answer, json.dumps(taken).encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
