"""A model whose steps take their time."""

from __future__ import annotations

from pathlib import Path

TEXT = '''"""A clock whose step takes its time."""
import time
from .model import Model, State, output, parameter

def derivatives(t, x, u, p):
    time.sleep({seconds})
    return {{"y": p.rate}}

MODEL = Model("slow", "Slow", (output("y", "1", "Output"), parameter("rate", "1/s", 1.0, "Rate")),
              states=(State("y"),), derivatives=derivatives, solver_step=lambda p: 0.1)
'''


def write(folder: Path, seconds: float) -> Path:
    """The model file, which sleeps so long at each inner step [s]."""
    file = folder / "slow.py"
    file.write_text(TEXT.format(seconds=seconds))
    return file
