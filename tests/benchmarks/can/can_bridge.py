"""Does a bridge keep its deadlines at 1 kHz, and is every frame on the wire received? Linux only.

Three processes: a rig behind a bus, its controller on a bridge, and serial adapters between them at 500 kbit/s, which
the two messages of every step keep busy to nearly a half. What the machine itself allows is measured first: a loop
that does nothing but wait for its deadlines.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

from orchestrator.can.slcan.hub import HubStatistics, hub_process
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import Pace, quiet
from orchestrator.realtime.stopping import Stop

from ..figure import Figure

ROOT = Path(__file__).parents[3]
COMMAND = [sys.executable, "-c", "from identification.cli import main; main()", "can"]
SECONDS, LONG, BITRATE = 60, 600, 500_000
ASKED = 0.999  # share of steps within 1 ms of their deadline
DATABASE = """VERSION ""
BU_: RIG LAW
BO_ 256 State: 8 RIG
 SG_ angle : 0|32@1- (0.000001,0) [0|0] "rad" LAW
 SG_ speed : 32|32@1- (0.00001,0) [0|0] "rad/s" LAW
BO_ 257 Command: 4 LAW
 SG_ voltage : 0|32@1- (0.000001,0) [-24|24] "V" RIG
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 1;
"""
RIG: dict[str, Any] = {
    "title": "Rig",
    "components": {"motor": {"model": "dc_motor"}, "hand": {"model": "pendulum", "parameters": {"angle_start": 0.7}}},
    "connections": ["hand.speed -> motor.speed", "motor.torque -> hand.torque"],
    "run": {"stop": 1, "step": 0.001},
    "can": {
        "database": "rig.dbc",
        "receive": {"motor.voltage": {"signal": "voltage", "safe": 0}},
        "send": {"angle": "hand.angle", "speed": "hand.speed"},
    },
}
LAW: dict[str, Any] = {
    "title": "Law",
    "components": {"law": {"model": "energy_controller", "parameters": {"gain": 0.02, "sample_time": 0.001}}},
    "run": {"stop": 1, "step": 0.001},
    "can": {
        "database": "rig.dbc",
        "receive": {"law.angle": {"signal": "angle", "safe": 0}, "law.speed": {"signal": "speed", "safe": 0}},
        "send": {"voltage": {"source": "law.voltage", "safe": 0}},
    },
}


def figures(seconds: int = SECONDS) -> list[Figure]:
    """How the deadlines were kept on both sides, and what became of the frames."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "rig.dbc").write_text(DATABASE)
        for name, scenario in (("rig", RIG), ("law", LAW)):
            (folder / f"{name}.yaml").write_text(json.dumps(scenario))
        waiting, stolen = only_waiting(min(seconds, 10)), _stolen()
        with hub_process(folder / "bus", bitrate=BITRATE) as hub:
            rig = start("bench", folder, "rig", 0)
            law = start("bridge", folder, "law", 1, "--duration", str(seconds))
            if law.wait():
                raise RuntimeError(f"the bridge failed: {law.communicate()[1]}")
            rig.send_signal(signal.SIGTERM)
            rig.wait()
            wire = hub.statistics()
        host = Figure("processor time that the host took away meanwhile", "-", f"{_stolen() - stolen:.2f} s")
        return [waiting, *judged({each: _manifest(folder, each) for each in ("rig", "law")}, wire, seconds), host]


def endurance() -> list[Figure]:
    """The same for ten minutes."""
    return figures(LONG)


def only_waiting(seconds: int) -> Figure:
    """How a loop without any work keeps its deadlines here and now."""
    deadlines, stop = Deadlines(0.001), Stop()
    with quiet():
        pace = Pace(time.monotonic(), Fraction(1, 1000))
        for number in range(1000 * seconds):
            deadline = pace.deadline(number)
            deadlines.begun(pace.wait(deadline, stop) - deadline)
    worst = 1e3 * deadlines.lateness.worst
    return Figure(
        f"a loop that only waits, {seconds} s: steps within 1 ms of their deadline",
        "-",
        f"{100 * deadlines.on_time:.3f} % (worst {worst:.2f} ms)",
    )


def start(mode: str, folder: Path, name: str, port: int, *options: str) -> subprocess.Popen[str]:
    """One side as a process, once it is on the bus."""
    bus = ["--interface", "slcan", "--channel", str(folder / "bus" / str(port)), "--bitrate", str(BITRATE)]
    process = subprocess.Popen(
        [*COMMAND, mode, str(folder / f"{name}.yaml"), *bus, "--out", str(folder / "out" / name), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "is on slcan" in line:
            return process
    raise RuntimeError(f"{name} did not get on the bus")


def judged(about: dict[str, dict[str, Any]], wire: HubStatistics, seconds: int) -> list[Figure]:
    """The figures."""
    found = []
    for name, title in (("law", f"bridge at 1 kHz for {seconds} s"), ("rig", "bench, others starting meanwhile")):
        kept = about[name]["deadlines"]
        late = kept["lateness"]
        found.append(
            Figure(
                f"{title}: steps within 1 ms of their deadline",
                f"at least {100 * ASKED:g} %" if name == "law" else "-",
                f"{100 * kept['on_time']:.3f} % (99.9 %: {1e3 * late['p99_9']:.2f} ms, worst "
                f"{1e3 * late['worst']:.2f} ms, work of a step {1e6 * kept['work']['median']:.0f} µs)",
                kept["on_time"] >= ASKED if name == "law" else None,
            )
        )
    sent, taken = about["law"]["sent"]["messages"]["Command"], about["rig"]["received"]["messages"]["Command"]
    lost = sent - taken + sum(port.lost + port.refused for port in wire.ports)
    found.append(Figure("frames lost on the wire", "0", f"{lost} of {wire.frames:,}", lost == 0))
    return [*found, Figure("time the wire was busy", "-", f"{100 * wire.busy / wire.elapsed:.0f} %")]


def _stolen() -> float:
    """Time for which processors of a virtual machine were ready and not run, since it was started [s]."""
    return int(Path("/proc/stat").read_text().split()[8]) / os.sysconf("SC_CLK_TCK")


def _manifest(folder: Path, name: str) -> dict[str, Any]:
    about: dict[str, Any] = json.loads((folder / "out" / name / "manifest.json").read_text())["can"]
    return about
