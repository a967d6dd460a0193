"""Refinement of a linear model by its prediction error."""
