"""The project's figures, measured: `python -m tests.benchmarks` prints them all, each module its own."""
