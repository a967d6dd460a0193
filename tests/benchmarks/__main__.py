"""The project's figures in one table: `make bench`, or those of the modules that are named.

With --endurance what takes long instead: many draws, many lives of an FMU, long runs and logs (`make endurance`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter
from traceback import print_exc
from types import ModuleType

import pytest

from .figure import Figure, report_groups

BENCH = {
    "startup": "processor time of commands, with a cache of built FMUs and without; Ctrl-C",
    "coverage": "how often the 95 % intervals of output error hold the truth, by profiles and locally",
    "candidates": "how often the right one of five friction laws is chosen",
    "coverage_frequency": "how often the 95 % intervals of the resonance study hold the truth",
    "coverage_motion": "how often those of a recalibration near a motion do",
    "subspace_speed": "subspace identification beside other tools",
    "calibration_speed": "the calibration from the real recordings; a step of a Python FMU",
    "calibration_peer": "the same on few windows beside FMPy with SciPy's least squares",
    "window_overhead": "a window of a calibration beside its stepping",
    "sensitivities": "the exact Jacobian of a run beside forward differences",
    "design_speed": "the shipped design of experiments, beside sweeps",
    "reports": "size of reports, first paint and zooms in Chromium",
    "tuning_speed": "PDP over three models; tuning with 1,000 draws",
    "many_runs": "1,000 runs of energy control",
    "sweep": "10,000 points of energy control into a data set: time, scaling, overhead, memory",
    "judging": "a million samples judged by a funnel about a reference",
    "closed_loops": "1,000 closed loops of the flexible arm, and one beside real time",
    "can_codec": "CAN frames to a trace and back, beside cantools",
    "can_logs": "BLF and text logs to frames and traces beside python-can and cantools, and memory",
    "can_wire": "frames over serial ports, relayed, received and recorded",
    "ls_bus": "frames a second over a simulated CAN bus, between nodes alone and between FMUs",
    "loop_speed": "a step in our loops, in C and in other tools",
    "fused_speed": "a step of a system in one FMU, beside a C program and the wired system",
    "loop_scaling": "time and memory over components and steps",
    "clocks": "ticks of FMI 3.0's clocks a second and core",
    "can_bridge": "deadlines and lost frames of a bridge at 1 kHz over serial adapters",
    "live_changes": "steps that changes of a run in real time make late",
    "ssp_import": "an SSP with 200 FMUs and 5,000 connections",
    "suite_speed": "200 short scenarios as a suite, one after the other and two at a time",
}
ENDURANCE = {
    "coverage": "how often the 95 % intervals of output error hold the truth, in 500 draws, and with play",
    "coverage_frequency": "how often the intervals of the resonance study hold the truth, in 400 draws",
    "can_codec": "a day of log in a stream",
    "loop_scaling": "runs of 10,000,000 steps",
    "loop_endurance": "what 100,000 lives of an FMU and 1,000,000 resets leave behind",
    "can_bridge": "deadlines and lost frames in ten minutes",
    "can_wire": "two full buses of 1 Mbit/s recorded for five minutes",
    "faults": "200 random faults of bridges and benches, seen by a foreign peer",
    "interruptions": "500 commands interrupted at random moments: what is lost or left",
}


def main(arguments: Sequence[str]) -> int:
    """Measure what is asked for; 1 where a claim that no machine changes does not hold, 2 for an unknown module."""
    endurance, names = chosen(arguments)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # commands find the project compiled, as they do where it is used
    modules = ENDURANCE if endurance else BENCH
    groups: dict[str, Sequence[Figure]] = {}
    for number, name in enumerate(names, 1):
        print(f"[{number}/{len(names)}] {name}: {modules[name]} ...", end=" ", file=sys.stderr, flush=True)
        begun = perf_counter()
        module = module_of(name)
        groups[name] = measured(module.endurance if endurance else module.figures)
        print(f"{perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    return report_groups(groups)


def module_of(name: str) -> ModuleType:
    """The module of that name, in whichever room it lies."""
    [file] = Path(__file__).parent.glob(f"*/{name}.py")
    return import_module(f"tests.benchmarks.{file.parent.name}.{name}")


def measured(figures: Callable[[], list[Figure]]) -> list[Figure]:
    """The figures of a module; one that says why there are none, so that the other modules still make their table."""
    try:
        return figures()
    except pytest.skip.Exception as reason:  # what other suppliers' FMUs are fetched with says so
        return [Figure("not measured", "-", str(reason))]
    except Exception as error:
        print_exc()
        return [Figure("measured to the end", "yes", f"{type(error).__name__}: {error}"[:80], False, certain=True)]


def chosen(arguments: Sequence[str]) -> tuple[bool, list[str]]:
    """Whether endurance is asked for, and the modules that are named, in the order of the table; all where none is."""
    parser = argparse.ArgumentParser(
        "python -m tests.benchmarks",
        description=__doc__,
        epilog="\n".join(["modules:", *listed(BENCH), "with --endurance:", *listed(ENDURANCE)]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="what to measure; everything by default")
    parser.add_argument("--endurance", action="store_true", help="what takes long instead")
    given = parser.parse_args(arguments)
    offered = ENDURANCE if given.endurance else BENCH
    unknown = [name for name in given.modules if name not in offered]
    if unknown:
        parser.error(f"there is no module {', '.join(unknown)}; choose among {', '.join(offered)}")
    return given.endurance, [name for name in offered if name in given.modules or not given.modules]


def listed(modules: Mapping[str, str]) -> list[str]:
    """A line for each module."""
    return [f"  {name:20}{about}" for name, about in modules.items()]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
