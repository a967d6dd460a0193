"""The project's figures in one table, or those of the modules that are named.

All of them take half an hour and more, most of it in the 100,000 lives of an FMU.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from time import perf_counter

from .figure import Figure, report_groups

MODULES = {
    "coverage_frequency": "how often the 95 % intervals of the resonance study hold the truth",
    "coverage_time": "how often those of output error do",
    "subspace_speed": "subspace identification beside other tools",
    "calibration_speed": "the calibration from the real recordings; a step of a Python FMU",
    "many_runs": "1,000 runs of energy control",
    "can_codec": "CAN frames to a trace and back, beside cantools; a day of log",
    "can_logs": "BLF logs to frames and traces beside python-can and cantools, and memory",
    "can_wire": "frames over serial ports, relayed, received and recorded",
    "loop_speed": "a step in our loops, in C and in other tools",
    "loop_scaling": "time and memory over components and steps",
    "loop_endurance": "what 100,000 lives of an FMU and 1,000,000 resets leave behind",
    "can_bridge": "deadlines and lost frames of a bridge at 1 kHz over serial adapters",
}


def main(arguments: Sequence[str]) -> int:
    """Measure what is asked for; 1 where a statistical claim does not hold, 2 where a module is not known."""
    names = chosen(arguments)
    groups: dict[str, Sequence[Figure]] = {}
    for number, name in enumerate(names, 1):
        print(f"[{number}/{len(names)}] {name}: {MODULES[name]} ...", end=" ", file=sys.stderr, flush=True)
        begun = perf_counter()
        groups[name] = import_module(f"{__package__}.{name}").figures()
        print(f"{perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    return report_groups(groups)


def chosen(arguments: Sequence[str]) -> list[str]:
    """The modules that are named, in the order of the table; all where none is."""
    epilog = "modules:\n" + "\n".join(f"  {name:20}{about}" for name, about in MODULES.items())
    parser = argparse.ArgumentParser(
        "python -m tests.benchmarks",
        description=__doc__,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="what to measure; everything by default")
    named = parser.parse_args(arguments).modules
    unknown = [name for name in named if name not in MODULES]
    if unknown:
        parser.error(f"there is no module {', '.join(unknown)}; choose among {', '.join(MODULES)}")
    return [name for name in MODULES if name in named or not named]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
