"""What is there of a sweep that has not come to its end."""

from __future__ import annotations

import json
from pathlib import Path

from orchestrator.batch.sweep.runs.folder import MANIFEST, header


def about_unfinished(folder: Path) -> dict[str, object]:
    """How far a sweep is, by its manifest.

    Raises:
        InputError: the folder is none of a sweep.
    """
    identity = header(folder)["identity"]
    done = failed = asked = 0
    with (folder / MANIFEST).open(encoding="utf-8") as lines:
        for line in lines:
            try:
                entry = json.loads(line)
            except ValueError:  # a command was killed while it wrote the last one
                break
            asked = int(entry.get("begun", asked))
            done = int(entry.get("there", done))
            done += sum(last - first + 1 for first, last in entry.get("runs", []))
            failed += int(entry.get("failed", 0))
    return {"name": f"sweep of {identity.get('sweep')}", "unfinished": f"{done:,} of {asked:,} runs", "failed": failed}
