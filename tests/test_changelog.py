"""Fragments of the changelog: each can be joined, and joining puts every entry where a reader looks for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, str(ROOT / ".ci" / "changelog.py")]
BEFORE = "# Changelog\n\n## [0.2.0] - unreleased\n\n### Added\n\n- One.\n\n## [0.1.0]\n\n### Added\n\n- Old.\n"


def join(root: Path, **fragments: str) -> subprocess.CompletedProcess[str]:
    (root / "changes").mkdir()
    (root / "CHANGELOG.md").write_text(BEFORE)
    for name, text in fragments.items():
        (root / "changes" / f"{name}.md").write_text(text)
    return subprocess.run([*COMMAND, str(root)], capture_output=True, text=True, check=False)


def test_the_fragments_that_are_there_can_be_joined(tmp_path: Path) -> None:
    here = {path.stem: path.read_text() for path in (ROOT / "changes").glob("*.md")}
    assert join(tmp_path, **here).stderr == ""


def test_entries_go_to_their_sections_of_the_newest_version_and_fragments_are_gone(tmp_path: Path) -> None:
    join(tmp_path, b="Fixed: a\n  long one.\nAdded: Three.", a="- Added: Two.\n")
    assert (tmp_path / "CHANGELOG.md").read_text() == BEFORE.replace(
        "- One.\n", "- One.\n- Two.\n- Three.\n\n### Fixed\n\n- a long one.\n"
    )
    assert list((tmp_path / "changes").iterdir()) == []


@pytest.mark.parametrize("text", ["Nicer: all.", "Added:", "  Added: x", "x\nAdded: y", ""])
def test_a_bad_fragment_is_named_and_nothing_is_written(tmp_path: Path, text: str) -> None:
    done = join(tmp_path, bad=text, good="Added: Two.")
    assert done.returncode == 1 and "bad.md" in done.stderr
    assert (tmp_path / "CHANGELOG.md").read_text() == BEFORE
