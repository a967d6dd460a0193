"""Co-simulation FMUs as tests load and run them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import numpy as np

from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import Trace

Load = Callable[[Path, str], Slave]


def run(
    paths: Mapping[str, Path],
    links: Sequence[tuple[str, str]] = (),
    *,
    step: Fraction,
    stop: Fraction,
    values: Mapping[str, Value] | None = None,
    stimuli: Mapping[str, np.ndarray] | None = None,
) -> Trace:
    """Outputs of these FMUs."""
    with ExitStack() as stack:
        files = {name: stack.enter_context(FmuFile(path)) for name, path in paths.items()}
        system = wire({name: Part(file.interface) for name, file in files.items()}, links, stimuli or {})
        slaves = {name: Slave(file, name) for name, file in files.items()}
        made = stack.enter_context(Simulation(system, slaves, Timing(stop, step)))
        return made.run(values, stimuli).trace
