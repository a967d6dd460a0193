"""A scenario of a fifth of a second: a pendulum swings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

SCENARIO: dict[str, Any] = {
    "title": "A swing",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},
    "run": {"stop": 0.2, "step": 0.01},
    "expect": [{"signal": "hand.angle", "below": 0.6}],
}


def write_scenario(folder: Path, **changes: Any) -> Path:
    """The scenario as a file; JSON is YAML."""
    path = folder / "swing.yaml"
    path.write_text(json.dumps(SCENARIO | changes))
    return path
