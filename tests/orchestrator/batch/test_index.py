"""The page of a suite: every verdict with the report behind it, what failed first."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import pytest

from fmus.errors import InputError
from orchestrator.batch.index import index_of, prepare, write_index
from orchestrator.batch.summary import SuiteSummary
from orchestrator.batch.verdict import Verdict
from orchestrator.results import FileDocument
from tests.support.tools.reports import EVIL


def document(title: str, out: Path, held: bool) -> FileDocument:
    checks = [{"text": f"{title} stays below 1", "held": held, "found": "largest 0.5 rad"}]
    return {
        "title": title,
        "passed": held,
        "out": str(out),
        "cases": [{"name": f"case of {title}", "passed": held, "error": None, "checks": checks}],  # type: ignore[typeddict-item]
    }


def suite(out: Path, word: str = "swing") -> SuiteSummary:
    (out / "good" / word).mkdir(parents=True)
    (out / "good" / word / "report.html").write_text("")
    verdicts = [
        Verdict(Path(f"good/{word}.yaml"), 1.25, document(word, out / "good" / word, True)),
        Verdict(Path("bad/slow.yaml"), 2.5, document("slow", out / "bad", False)),
        Verdict(Path("bad/none.yaml"), 0.1, None, "no such model"),
    ]
    return SuiteSummary(verdicts, 4.0, 1)


def test_what_failed_comes_first_and_tells_why(tmp_path: Path) -> None:
    html = index_of(suite(tmp_path), tmp_path).render()
    assert re.findall(r'<tbody class="(\w+)">', html) == ["error", "error", "ok"]
    rows = re.findall(r"<tbody.*?</tbody>", html)
    assert "slow stays below 1, found largest 0.5 rad" in rows[0] and "<details open>" in rows[0]
    assert "no such model" in rows[1]
    assert "<details>" in rows[2] and "1 of 1" in rows[2]
    assert "1 of 3 files" in html and "Not all passed." in html


def test_each_report_that_is_there_is_behind_its_verdict(tmp_path: Path) -> None:
    page = write_index(suite(tmp_path), tmp_path)
    links = [link for link in re.findall(r'<a href="(.*?)"', page.read_text()) if not link.startswith("#")]
    assert links == ["good/swing/report.html"]
    assert (page.parent / links[0]).is_file()


def test_the_style_of_the_page_is_the_one_that_reports_share(tmp_path: Path) -> None:
    summary = suite(tmp_path)
    prepare(tmp_path)
    (style,) = re.findall(r'<link rel="stylesheet" href="(.*?)"', write_index(summary, tmp_path).read_text())
    assert (tmp_path / style).read_text() == (resources.files("orchestrator.report") / "style.css").read_text()


def test_names_from_outside_are_neither_markup_nor_addresses(tmp_path: Path) -> None:
    word = EVIL.replace("/", "")
    html = index_of(suite(tmp_path, word), tmp_path).render()
    assert "<script" not in html and "<img" not in html
    [link] = [link for link in re.findall(r'href="(.*?)"', html) if not link.startswith("#")]
    assert not re.search(r"[<>\s'&:]", link)
    named = index_of(suite(tmp_path / "b", "javascript:alert(1)"), tmp_path / "b").render()
    assert 'href="good/javascript%3Aalert%281%29/report.html"' in named


def test_the_page_of_somebody_else_is_not_replaced(tmp_path: Path) -> None:
    summary = suite(tmp_path)
    prepare(tmp_path)
    write_index(summary, tmp_path)
    prepare(tmp_path)
    (tmp_path / "index.html").write_text("<h1>Mine</h1>")
    with pytest.raises(InputError, match="no command of ours wrote it"):
        prepare(tmp_path)
