"""What a step of a system in one FMU costs beside a hand-written C program of it, and beside the wired system.

The work: five pendulums of the library in a ring, each driven by a torque that follows the angle of the one before;
three step by 1 ms, two by 2 ms; 20,000 steps, from which the angles are recorded. The C program has the same equations,
Runge-Kutta method, order and rates; it and what steps the FMU are compiled alike, and their processor time is taken
from the first step to the last. The fused and the wired system run in our compiled loop, from the reset to the trace.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from time import thread_time

import fmpy
import numpy as np

from fmus.packaging.native import compiler
from fmus.packaging.system.build import FLAGS
from orchestrator.assembly.assembly import OpenSystem, assemble, open_system
from orchestrator.engine import Simulation
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.scenario.fusing import build, fuse
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import FloatArray

from ..figure import Figure
from .loop_speed import interleaved, nanoseconds, ratio

HERE = Path(__file__).parent
COUNT, STEPS, STEP, GAIN = 5, 20_000, 0.001, 0.002
EVERY = (1, 1, 2, 1, 2)
ANGLES = (0.1, 0.4, -0.3, 0.8, -0.6)
PARAMETERS = {
    "inertia": 0.004,
    "viscous_friction": 2e-3,
    "gravity_torque": 0.04,
    "coulomb_friction_positive": 1e-4,
    "coulomb_friction_negative": 2e-4,
    "stribeck_friction": 5e-5,
    "stribeck_speed": 0.1,
    "friction_speed": 0.05,
    "equilibrium_angle": 0.02,
}
BY_C, BY_WIRES = 1.2, 1.0


def figures() -> list[Figure]:
    """Nanoseconds per pendulum and step of all loops, and what the FMU is against the others."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        scenario = load_scenario(ring(folder))
        path = build(fuse(folder / "ring.yaml"), folder)
        program = Program(stack.enter_context(FmuFile(path)), folder)
        wires = stack.enter_context(OpenSystem(assemble(scenario.system, folder)))
        whole = stack.enter_context(open_system({"ring": path}))
        wired = stack.enter_context(wires.simulation(scenario.timing))
        fused = stack.enter_context(whole.simulation(scenario.timing))
        values = wires.assembled.system.values()
        same = np.array_equal(program.by_fmu(), rows(wired, "", values))
        near = float(np.abs(program.by_hand() - program.by_fmu()).max())
        times = interleaved(
            {
                "hand": program.seconds_by_hand,
                "fmu": program.seconds_by_fmu,
                "wired": lambda: seconds(wired, "", values),
                "fused": lambda: seconds(fused, "ring.", {}),
            }
        )
    return [
        *(Figure(f"{what}: a step of a pendulum", "-", nanoseconds(times[key])) for key, what in TOLD.items()),
        Figure("every sample is that of the wired system", "yes", "yes" if same else "no", same, certain=True),
        Figure(
            "largest difference to the C program", "at most 1e-9 rad", f"{near:.1e} rad", near <= 1e-9, certain=True
        ),
        ratio("the fused FMU takes", times["fmu"], times["hand"], "the C program", at_most=BY_C),
        ratio("in our loop it takes", times["fused"], times["wired"], "the wired system", at_most=BY_WIRES),
    ]


TOLD = {
    "hand": "hand-written C program",
    "fmu": "fused FMU, stepped from C",
    "fused": "fused FMU in our compiled loop",
    "wired": "wired system in our compiled loop",
}


def ring(folder: Path) -> Path:
    """The scenario of the ring."""
    components = {
        f"h{i}": {"model": "pendulum", "step": EVERY[i] * STEP, "parameters": PARAMETERS | {"angle_start": ANGLES[i]}}
        for i in range(COUNT)
    }
    document = {
        "title": "Five pendulums in a ring",
        "components": components,
        "connections": [f"{GAIN} * h{(i - 1) % COUNT}.angle -> h{i}.torque" for i in range(COUNT)],
        "run": {"stop": STEPS * STEP, "step": STEP},
        "record": [f"h{i}.angle" for i in range(COUNT)],
    }
    (folder / "ring.yaml").write_text(json.dumps(document))
    return folder / "ring.yaml"


def seconds(simulation: Simulation, prefix: str, values: Mapping[str, Value]) -> float:
    """The processor's time of one whole run [s]."""
    begun = thread_time()
    simulation.run(values, record=recorded(prefix))
    return thread_time() - begun


def rows(simulation: Simulation, prefix: str, values: Mapping[str, Value]) -> FloatArray:
    """(K, 5) the angles."""
    trace = simulation.run(values, record=recorded(prefix)).trace
    return np.column_stack([trace[name] for name in recorded(prefix)])


def recorded(prefix: str) -> list[str]:
    return [f"{prefix}h{i}.angle" for i in range(COUNT)]


class Program:
    """`fused_by_hand.c`, compiled here with the flags of FMUs."""

    def __init__(self, file: FmuFile, folder: Path) -> None:
        library = folder / "by_hand.so"
        command = [*compiler.command_for(compiler.host()), *compiler.FLAGS, *FLAGS, "-fPIC", "-fvisibility=default"]
        command += ["-D_POSIX_C_SOURCE=199309L", f"-I{Path(fmpy.__file__).parent / 'c-code'}"]
        source = str(HERE / "fused_by_hand.c")
        subprocess.run([*command, source, "-ldl", "-lm", "-o", str(library)], check=True)
        loaded = ctypes.CDLL(str(library))
        self._by_hand, self._by_fmu = loaded.by_hand, loaded.by_fmu
        self._by_hand.restype = self._by_fmu.restype = ctypes.c_double
        self._rows = np.zeros((STEPS + 1, COUNT))
        binary = file.folder / "binaries" / fmpy.platform / f"{file.identifier}{fmpy.sharedLibraryExtension}"
        resources = (file.folder / "resources").as_uri()
        self._fmu = str(binary).encode(), file.description.guid.encode(), resources.encode()
        references = [file.interface.ports[name].reference for name in recorded("")]
        self._references = np.array(references, dtype=np.uint32)
        self._parameters, self._angles = np.array([*PARAMETERS.values()]), np.array(ANGLES)
        self._every = np.array(EVERY, dtype=np.int64)

    def seconds_by_hand(self) -> float:
        """Processor time from the first step to the last [s]."""
        given = (self._parameters, self._angles, self._every)
        where = [ctypes.c_void_p(array.ctypes.data) for array in given]
        rest = ctypes.c_double(GAIN), ctypes.c_long(STEPS), ctypes.c_double(STEP)
        return float(self._by_hand(*where, *rest, ctypes.c_void_p(self._rows.ctypes.data)))

    def seconds_by_fmu(self) -> float:
        """The same of the FMU."""
        references = ctypes.c_void_p(self._references.ctypes.data)
        rest = ctypes.c_long(STEPS), ctypes.c_double(STEP), ctypes.c_void_p(self._rows.ctypes.data)
        taken = float(self._by_fmu(*self._fmu, references, *rest))
        if taken < 0:
            raise RuntimeError("the fused FMU failed")
        return taken

    def by_hand(self) -> FloatArray:
        """(K, 5) the angles."""
        self.seconds_by_hand()
        return self._rows.copy()

    def by_fmu(self) -> FloatArray:
        """(K, 5) the angles."""
        self.seconds_by_fmu()
        return self._rows.copy()
