"""Signals of a bus to inputs of components, and outputs to signals."""
