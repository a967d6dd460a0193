"""How long the shipped design of experiments takes, and what its experiments are predicted to bring beside sweeps."""

from __future__ import annotations

from pathlib import Path
from time import process_time

from identification import design
from identification.design.design import Design

from ..figure import Figure

STUDY = Path(__file__).parents[3] / "scenarios" / "butterfly" / "design.yaml"
TWICE = 2.0  # narrower than the sweeps' worst half-width


def figures() -> list[Figure]:
    """Processor time of a run with its information, and the ratio of worst half-widths."""
    begun = process_time()
    found: Design = design(STUDY).result
    spent = process_time() - begun
    ratio = float(found.relative(found.compared["sweeps"]).max() / found.relative(found.after).max())
    return [
        Figure("the shipped design of three experiments", "-", f"{spent:.1f} s"),
        Figure("a run of the rig with what it tells", "-", f"{1e3 * spent / found.found.runs:.0f} ms"),
        Figure("worst half-width of sweeps over the design's", f"at least {TWICE:g}", f"{ratio:.2f}", ratio >= TWICE),
    ]
