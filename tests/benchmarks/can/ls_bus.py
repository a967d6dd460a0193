"""How many frames a second go over a simulated CAN bus (FMI-LS-BUS), between nodes alone and between FMUs."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.can.ls_bus.ideal_bus import IdealBus
from orchestrator.can.ls_bus.operations import Transmit, encoded
from orchestrator.engine import Timing
from orchestrator.network.bus_spec import BusSpec
from orchestrator.rational import seconds
from tests.support.fmus import bus_nodes

from ..figure import Figure

ASKED = 200_000  # frames a second through the bus
FRAMES, BATCH, RUNS = 100_000, 10, 3
RATE, LONGEST = 500_000, 0.00027  # bit/s, and more than a frame takes [s]
PERIOD, SPAN = 0.001, 10.0  # of each FMU's frames, and of the run [s]


def figures() -> list[Figure]:
    """Frames per second of processor time, arbitrated, timed by their stuff bits, and given to all other nodes."""
    load = f"load {os.getloadavg()[0]:.1f}"
    found = []
    for nodes in (2, 8):
        rate = max(_through(nodes) for _ in range(RUNS))
        name = f"frames of 8 bytes through a bus of {nodes} nodes, {load}"
        found.append(Figure(name, f"{ASKED:,} frames/s", f"{rate:,.0f} frames/s", rate >= ASKED))
    rate = max(_between_fmus() for _ in range(RUNS))
    found.append(Figure(f"between two FMUs, a tick each, {load}", "-", f"{rate:,.0f} frames/s"))
    return found


def _through(nodes: int) -> float:
    bus = IdealBus("can0", [f"n{number}" for number in range(nodes)], RATE, None)
    sent = [
        encoded([Transmit(0x100 + k, False, False, 8, bytes([count, k, 0, 255, 3, 4, 5, 6])) for k in range(BATCH)])
        for count in range(256)
    ]
    step, begun = BATCH * LONGEST, process_time()
    for number in range(FRAMES // BATCH):
        bus.take(number % nodes, number * step, sent[number % 256])
        bus.run((number + 1) * step)
        for node in bus.nodes:
            node.inbox = []
    spent = process_time() - begun
    assert bus.carried == FRAMES
    return FRAMES / spent


def _between_fmus() -> float:
    with TemporaryDirectory() as folder:
        fmu = bus_nodes.build(Path(folder))
        given = {"period": PERIOD, "first": PERIOD}
        parts = {"a": ComponentSpec(fmu, given), "b": ComponentSpec(fmu, {**given, "id": 512.0})}
        system = SystemSpec(parts, buses={"can0": BusSpec(("a.Can", "b.Can"), RATE)})
        timing = Timing(seconds(SPAN, "stop"), seconds(PERIOD, "step"))
        with OpenSystem(assemble(system, Path(folder))) as opened, opened.simulation(timing) as simulation:
            begun = process_time()
            result = simulation.run(opened.assembled.system.values(), record=["can0.frames"])
            return len(result.carried["can0"].frames) / (process_time() - begun)
