"""All figures in one table; takes half an hour, most of it in the 100,000 lives of an FMU."""

from __future__ import annotations

import sys

from . import calibration_speed, coverage_frequency, coverage_time, loop_endurance, loop_scaling, loop_speed
from .figure import report


def main() -> int:
    """Measure everything; 1 where a statistical claim does not hold."""
    modules = (coverage_frequency, coverage_time, calibration_speed, loop_speed, loop_scaling, loop_endurance)
    return report([figure for module in modules for figure in module.figures()])


if __name__ == "__main__":
    sys.exit(main())
