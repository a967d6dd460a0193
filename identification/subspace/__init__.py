"""ORSE and its relatives, and refinement by prediction error."""
