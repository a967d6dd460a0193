"""Systems as `.ssp` archives of System Structure and Parameterization 1.0 and 2.0, in and out."""

from __future__ import annotations

from pathlib import Path


def is_ssp(path: Path) -> bool:
    """Whether a file is an SSP, by its name."""
    return path.suffix.lower() == ".ssp"
