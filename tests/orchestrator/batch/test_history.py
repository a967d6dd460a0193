"""What failed last time is known of every file that ran into a folder, whenever that was."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import InputError
from orchestrator.batch.history import FILE, failed, remember


def files(folder: Path) -> list[Path]:
    made = [folder / f"{name}.yaml" for name in "abc"]
    for file in made:
        file.touch()
    return made


def test_those_that_failed_are_kept_until_they_pass_also_when_others_run_meanwhile(tmp_path: Path) -> None:
    a, b, c = files(tmp_path)
    out = tmp_path / "out"
    remember({a: False, b: False, c: True}, out)
    assert failed([a, b, c], out) == [a, b]
    remember({a: True}, out)
    assert failed([a, b, c], out) == [b]
    remember({c: False}, out)
    assert failed([c, b], out) == [c, b]
    b.unlink()
    remember({c: True}, out)
    assert failed([a, c], out) == []


@pytest.mark.parametrize("text", [None, "", "[]", '{"passed": 3}', '{"passed": {"x": 1}}', "[" * 100_000])
def test_without_a_memory_that_is_said(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / FILE).write_text(text)
    with pytest.raises(InputError, match=r"none of the files has been run into .* yet"):
        failed(files(tmp_path), tmp_path)
