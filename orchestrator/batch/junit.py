"""The verdicts of the regression suite as JUnit XML, for continuous integration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.files import atomic_write
from orchestrator.batch.verdict import Verdict, reasons
from orchestrator.display.plain import plain
from orchestrator.results import CaseDocument


def write_junit(verdicts: Iterable[Verdict], path: Path) -> None:
    """The verdicts as JUnit XML: a suite a file, a test case a case, with the time that each took and, as properties,
    where the results are and what each check has found. A case that ended in an error is an error, one that ran and did
    not hold is a failure."""
    given = list(verdicts)
    root = ET.Element("testsuites", name="servotwin")
    _count(root, [case for verdict in given for case in verdict.cases], sum(verdict.seconds for verdict in given))
    for verdict in given:
        suite = ET.SubElement(root, "testsuite", name=str(verdict.file))
        _count(suite, verdict.cases, verdict.seconds)
        if verdict.document is not None:
            _properties(suite, {"title": verdict.document["title"], "results": verdict.document["out"]}.items())
        for case in verdict.cases:
            _add(suite, verdict, case)
    ET.indent(root)
    atomic_write(path, ET.tostring(root, encoding="UTF-8", xml_declaration=True))


def _count(element: ET.Element, cases: Sequence[CaseDocument], seconds: float) -> None:
    failed = [case for case in cases if not case["passed"]]
    errors = sum(case["error"] is not None for case in failed)
    element.set("tests", str(len(cases)))
    element.set("failures", str(len(failed) - errors))
    element.set("errors", str(errors))
    element.set("time", f"{seconds:.3f}")


def _add(suite: ET.Element, verdict: Verdict, case: CaseDocument) -> None:
    entry = ET.SubElement(
        suite, "testcase", name=plain(case["name"]), classname=verdict.file.stem, file=str(verdict.file)
    )
    if "seconds" in case:
        entry.set("time", f"{case['seconds']:.3f}")
    _properties(entry, ((check["text"], check["found"]) for check in case["checks"]))
    if not case["passed"]:
        why = reasons(case)
        told = ET.SubElement(entry, "failure" if case["error"] is None else "error", message=plain(why[0]))
        told.text = plain("\n".join(why))
    if "output" in case:
        ET.SubElement(entry, "system-out").text = plain(case["output"])


def _properties(element: ET.Element, pairs: Iterable[tuple[str, str]]) -> None:
    found = [(plain(name), plain(value)) for name, value in pairs]
    if found:
        held = ET.SubElement(element, "properties")
        for name, value in found:
            ET.SubElement(held, "property", name=name, value=value)
