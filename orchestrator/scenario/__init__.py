"""A scenario file: its cases run, judged and kept."""
