"""All figures in one table; takes several minutes."""

from __future__ import annotations

import sys

from . import calibration_speed, coverage_frequency, coverage_time
from .figure import report


def main() -> int:
    """Measure everything; 1 where a statistical claim does not hold."""
    return report([*coverage_frequency.figures(), *coverage_time.figures(), *calibration_speed.figures()])


if __name__ == "__main__":
    sys.exit(main())
