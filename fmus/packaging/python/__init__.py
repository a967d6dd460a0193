"""Python FMUs: the model file as it is, run by pythonfmu."""

from fmus.packaging.python.build import build

__all__ = ["build"]
