"""Native FMUs: generated C, its runtime, and the compiler."""

from fmus.packaging.native.build import build

__all__ = ["build"]
