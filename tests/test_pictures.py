"""The pictures of reports in the pages: each page shows those that are taken, and each can be taken anew."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
TAKEN = sorted(file.stem for file in (DOCS / "pictures").glob("*.png"))


def test_each_picture_is_shown_and_each_shown_is_there() -> None:
    shown = [
        name for page in DOCS.rglob("*.md") for name in re.findall(r"\(\.\./pictures/(\w+)\.png\)", page.read_text())
    ]
    assert sorted(shown) == TAKEN and TAKEN


@pytest.mark.slow
@pytest.mark.needs("browser", "chromium")
def test_a_picture_is_taken_anew(tmp_path: Path) -> None:
    shutil.copy(DOCS / "pictures.py", tmp_path / "pictures.py")
    subprocess.run([sys.executable, tmp_path / "pictures.py", "run"], check=True, cwd=DOCS.parent, timeout=600)
    head = (tmp_path / "pictures" / "run.png").read_bytes()[:24]
    assert head.startswith(b"\x89PNG") and struct.unpack(">II", head[16:]) == (1100, 720)
