"""One page tells how a suite went, however long it is, and nothing in a name or a message can spoil it."""

from __future__ import annotations

from pathlib import Path

from orchestrator.batch.summary import MOST, SLOWEST, SuiteSummary, github_lines
from orchestrator.batch.verdict import Verdict
from orchestrator.results import CheckDocument, FileDocument


def verdict(name: str, *held: bool, seconds: float = 1.0) -> Verdict:
    """Of a file with a case for each of these outcomes."""

    def check(ok: bool) -> CheckDocument:
        return {"text": "y | z stays below 1", "held": ok, "found": "largest 2\n::error::"}

    document: FileDocument = {
        "title": name,
        "passed": all(held),
        "out": "out",
        "cases": [{"name": f"a, {n}", "passed": ok, "error": None, "checks": [check(ok)]} for n, ok in enumerate(held)],
    }
    return Verdict(Path(name), seconds, document)


def test_the_sentence_counts_files_and_cases_and_says_what_side_by_side_has_gained() -> None:
    summary = SuiteSummary(
        [verdict("a", True, False), verdict("b", True), Verdict(Path("c"), 2.0, None, "broken")], 2.5, 2
    )
    assert summary.sentence == (
        "1 of 3 files and 2 of 4 cases passed in 2.5 s; one after the other they took 4.0 s (-j 2)"
    )


def test_the_sentence_counts_cases_that_pass_for_want_of_anything_asked() -> None:
    asked, idle = verdict("a", True), verdict("b", True, True)
    assert idle.document is not None
    for case in idle.document["cases"]:
        case["checks"] = []
    said = SuiteSummary([asked, idle], 1.0, 1).sentence
    assert said.startswith("2 of 2 files and 3 of 3 cases passed (2 of them without being asked anything) in 1.0 s;")


def test_a_short_suite_lists_every_file_and_a_long_one_what_failed_and_what_took_longest() -> None:
    short = SuiteSummary([verdict("a", True), verdict("b", False)], 1.0, 1)
    assert [row[:2] for row in short.rows()] == [("a", "passed"), ("b", "FAILED")]
    many = [verdict(f"{number:03}.yaml", number % 4 > 0, seconds=float(number)) for number in range(200)]
    rows = SuiteSummary(many, 1.0, 1).rows()
    assert sum(row[1] == "FAILED" for row in rows[:-1]) >= MOST
    assert {f"{number:03}.yaml" for number in range(200 - SLOWEST, 200)} <= {row[0] for row in rows}
    assert rows[-1][0] == f"and {50 - MOST} more" and len(rows) <= MOST + SLOWEST + 1
    assert len(SuiteSummary(many, 1.0, 1).rows(all_files=True)) == 200


def test_the_page_for_browsers_keeps_its_table_whatever_a_message_holds() -> None:
    page = SuiteSummary([verdict("<a>.yaml", False)], 1.0, 1).markdown()
    (row,) = [line for line in page.splitlines() if "stays below" in line]
    assert "y \\| z stays below 1, found largest 2 ::error::" in row and row.count("|") == 5


def test_github_is_told_of_each_failed_case_at_its_file_and_of_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "x" / "a,b.yaml"
    lines = github_lines([verdict(str(file), True, False), verdict("fine.yaml", True)], tmp_path)
    assert lines == [
        "::error file=x/a%2Cb.yaml,title=a%2C 1::y | z stays below 1, found largest 2%0A::error::",
    ]
