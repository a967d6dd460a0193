"""The figures of stepping: a loop, a run, many runs, a whole system."""
