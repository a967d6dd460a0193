"""Result folders are there as a whole or not at all, and replace nothing but results."""

from __future__ import annotations

import json
import math
import re
import stat
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import InputError
from fmus.owned import MARK
from orchestrator import results
from orchestrator.results import (
    RECORD,
    Permission,
    aside,
    check_target,
    default_folder,
    permitted,
    prepare,
    rescue,
    result_folder,
    versions,
    write_json,
)


def fill(target: Path, **files: str) -> None:
    """A result with these files, and the mark that it is one."""
    with result_folder(target) as folder:
        write_json(folder / "manifest.json", {"versions": versions()})
        for name, text in files.items():
            (folder / name).write_text(text)


def contents(folder: Path) -> set[str]:
    """What is there, besides the record of a result."""
    return {path.name for path in folder.iterdir()} - {RECORD}


def test_a_result_appears_where_it_was_asked_for_with_its_parents(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "er" / "out"
    fill(target, a="1")
    assert contents(target) == {"manifest.json", "a"}
    assert contents(target.parent) == {"out"}
    assert stat.S_IMODE(target.stat().st_mode) & 0o700 == 0o700


def test_the_result_is_not_there_before_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with result_folder(target) as folder:
        (folder / "a").write_text("half")
        assert not target.exists()
        assert folder.parent.parent == tmp_path  # the same file system, so that renaming is atomic
    assert (target / "a").read_text() == "half"


def test_an_earlier_result_stays_until_the_new_one_is_complete_and_is_then_gone(tmp_path: Path) -> None:
    target = tmp_path / "out"
    fill(target, old="1", both="old")
    with result_folder(target) as folder:
        (folder / "manifest.json").write_text("{}")
        assert (target / "old").is_file()
    assert contents(target) == {"manifest.json"}
    assert contents(tmp_path) == {"out"}


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_exception_leaves_the_earlier_result_and_nothing_else(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "out"
    fill(target, old="1")
    with pytest.raises(error), result_folder(target) as folder:
        (folder / "new").write_text("half")
        raise error
    assert contents(target) == {"manifest.json", "old"}
    assert contents(tmp_path) == {"out"}


def test_an_exception_without_earlier_result_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), result_folder(tmp_path / "out"):
        raise RuntimeError
    assert contents(tmp_path) == set()


def test_when_the_new_result_cannot_be_put_in_place_the_earlier_one_is_put_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out"
    fill(target, old="1")
    rename = Path.rename

    def failing(self: Path, other: Path) -> Path:
        if self.name == "fresh":
            raise OSError("disk full")
        return rename(self, other)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OSError, match="disk full"):
        fill(target, new="1")
    assert contents(target) == {"manifest.json", "old"}
    assert contents(tmp_path) == {"out"}


@pytest.mark.parametrize(
    "manifest",
    [
        None,
        "",
        "not json",
        "[]",
        "{}",
        '{"versions": 3}',
        '{"versions": {"chrome": 1}}',
        '{"name": "servotwin"}',
        "[" * 100_000,
    ],
)
def test_a_folder_that_holds_something_else_is_refused_and_left_alone(tmp_path: Path, manifest: str | None) -> None:
    target = tmp_path / "project"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    if manifest is not None:
        (target / "manifest.json").write_text(manifest)
    before = contents(target)
    with pytest.raises(InputError) as refused:
        fill(target)
    assert (
        str(refused.value)
        == f"{target}: is not empty and holds no result; give another --out, or --force to replace it"
    )
    assert contents(target) == before
    assert contents(tmp_path) == {"project"}


@pytest.mark.parametrize("mark", results.MARKS)
def test_a_folder_with_a_mark_of_ours_is_replaced(tmp_path: Path, mark: str) -> None:
    target = tmp_path / "out"
    target.mkdir()
    write_json(target / mark, {"versions": versions()})
    fill(target, a="1")
    assert contents(target) == {"manifest.json", "a"}


@pytest.mark.parametrize("foreign", ["notes.txt", "fmus/own.fmu", "sub/deep/er", ".hidden", "a", "validation/note"])
def test_a_result_that_holds_files_of_others_is_replaced_by_force_only(tmp_path: Path, foreign: str) -> None:
    target = tmp_path / "out"
    fill(target, a="1", b="2")
    fill(target / "validation", c="3")
    fill(target, a="1")  # a result beside it is ours, too
    fill(target / "validation", c="3")
    (target / foreign).parent.mkdir(exist_ok=True, parents=True)
    (target / foreign).write_text("hours of work")
    with pytest.raises(InputError, match=re.escape(f"out: holds {foreign}, which") + ".*--force to replace all"):
        fill(target, a="2")
    assert (target / foreign).read_text() == "hours of work"
    with permitted(Permission(force=True)):
        fill(target, a="2")
    assert contents(target) == {"manifest.json", "a"}


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("name", [".", "..", "results", "results/data"])
def test_neither_the_working_folder_nor_one_that_holds_it_or_an_input_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, force: bool
) -> None:
    fill(tmp_path / "results", data="1")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path if name.startswith("results") else tmp_path / "here")
    before = sorted(tmp_path.rglob("*"))
    with permitted(Permission(force, (tmp_path / "results" / "data",))), pytest.raises(InputError):
        fill(Path(name), a="1")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_disk_and_a_place_without_writing_are_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "LEAST_FREE", 1 << 60)
    with pytest.raises(InputError, match=r"out: is on a disk with \d+ MB left; make space"):
        results.check_target(tmp_path / "deep" / "out")
    monkeypatch.setattr(results, "owned_folder", refused)
    with pytest.raises(InputError, match=r"out: cannot be written \(Read-only file system\)"):
        results.check_target(tmp_path / "deep" / "out")
    assert contents(tmp_path) == set()


def refused(*_: object) -> None:
    raise OSError(30, "Read-only file system")


def test_what_a_killed_command_left_goes_and_the_result_it_took_away_comes_back(tmp_path: Path) -> None:
    target, left = tmp_path / "out", tmp_path / f".out{MARK}0123abcd"
    fill(target, old="1")
    left.mkdir()
    target.rename(left / "earlier")
    (tmp_path / ".out.backup").mkdir()
    with pytest.raises(RuntimeError), result_folder(target):
        raise RuntimeError
    assert contents(target) == {"manifest.json", "old"}
    assert contents(tmp_path) == {"out", ".out.backup"}


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    fill(tmp_path / "out", a="1")
    assert contents(tmp_path / "out") == {"manifest.json", "a"}


def test_a_file_in_the_way_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("precious")
    with pytest.raises(InputError, match="out: is a file; give another --out"):
        fill(tmp_path / "out")
    with pytest.raises(InputError, match="cannot be written"):
        fill(tmp_path / "out" / "below")
    assert (tmp_path / "out").read_text() == "precious"


def test_a_relative_target_and_a_link_lead_to_the_real_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    fill(Path("link"), a="1")
    fill(Path("sub/../other"), b="2")
    assert (tmp_path / "link").is_symlink()
    assert contents(tmp_path / "real") == {"manifest.json", "a"}
    assert contents(tmp_path / "other") == {"manifest.json", "b"}


def test_versions_name_python_and_every_package() -> None:
    found = versions()
    assert set(found) == {"python", *results.PACKAGES}
    assert found["numpy"][0].isdigit()


@pytest.mark.parametrize("document", [{"a": 0.1 + 0.2}, {"a": [1e-300, -0.0]}, {"b": {"c": [None, True, "é"]}}])
def test_json_keeps_every_bit(tmp_path: Path, document: dict[str, Any]) -> None:
    write_json(tmp_path / "a.json", document)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == document


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_json_that_json_does_not_have_is_refused(tmp_path: Path, value: float) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"a": value})


def recorded(tmp_path: Path) -> Path:
    near = tmp_path / "near"
    near.mkdir()
    (near / "0.arrows").write_bytes(b"rows")
    prepare(near, ["0.arrows", "0.parquet"], tmp_path / "out", {"scenario": "law.yaml"})
    return near


def test_a_record_becomes_a_result_that_the_next_may_replace(tmp_path: Path) -> None:
    near = recorded(tmp_path)
    assert rescue(near) == f"the result up to there is in {tmp_path / 'out'}"
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["scenario"] == "law.yaml" and manifest["ended"] == "failed" and manifest["trace"] == "run.arrows"
    assert (tmp_path / "out" / "run.arrows").read_bytes() == b"rows"
    check_target(tmp_path / "out")
    assert rescue(near) == ""


def test_a_result_that_was_written_is_left_alone(tmp_path: Path) -> None:
    near = recorded(tmp_path)
    with result_folder(tmp_path / "out") as folder:
        write_json(folder / "manifest.json", {"ended": "done", "versions": {"servotwin": "1"}})
    assert rescue(near) == ""
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "done"


def test_where_nothing_was_recorded_there_is_no_result(tmp_path: Path) -> None:
    near = recorded(tmp_path)
    (near / "0.arrows").unlink()
    assert rescue(near) == "" and rescue(tmp_path) == ""
    (near / "rescue.json").write_text("[1")
    assert rescue(near) == "" and not (tmp_path / "out").exists()


def test_two_files_of_one_name_do_not_share_the_folder_that_is_theirs_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    one, other = tmp_path / "a" / "x.yaml", tmp_path / "b" / "x.yaml"
    for file in (one, other):
        file.parent.mkdir()
        file.write_text("title: x")
    assert default_folder(one) == default_folder(other) == Path("out/x")
    with permitted(Permission(inputs=(one,))), result_folder(Path("out/x")) as folder:
        write_json(folder / "manifest.json", {"versions": versions()})
    assert default_folder(one) == Path("out/x") and default_folder(other, "_bench") == Path("out/x_bench")
    with pytest.raises(InputError, match=r"out/x: is the folder for the results of a/x\.yaml, too; give another --out"):
        default_folder(other)


def test_a_folder_that_another_command_is_filling_is_taken_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with permitted(Permission(inputs=(Path("a/x.yaml"),))), aside(Path("out/x")):
        with pytest.raises(InputError, match=r"results of a/x\.yaml, too"):
            default_folder(Path("b/x.yaml"))
        assert default_folder(Path("a/x.yaml")) == Path("out/x")
    assert default_folder(Path("b/x.yaml")) == Path("out/x")
