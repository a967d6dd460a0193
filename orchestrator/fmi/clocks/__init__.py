"""Clocks of FMI 3.0 in plain values: what FMUs declare of them, when they tick, and ticks on their way."""
