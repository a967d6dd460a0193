"""The verdicts of the regression suite as JUnit XML, for continuous integration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.files import atomic_write
from orchestrator.batch.suite import Verdict
from orchestrator.results import CaseDocument


def write_junit(verdicts: Iterable[Verdict], path: Path) -> None:
    """The verdicts as JUnit XML: a suite a scenario, a test case a case."""
    root = ET.Element("testsuites", name="servotwin")
    for verdict in verdicts:
        cases: Sequence[CaseDocument] = (
            verdict.document["cases"]
            if verdict.document
            else [{"name": "run", "passed": False, "error": verdict.error, "checks": []}]
        )
        failed = sum(not case["passed"] for case in cases)
        suite = ET.SubElement(
            root,
            "testsuite",
            name=str(verdict.file),
            tests=str(len(cases)),
            failures=str(failed),
            errors="0" if verdict.document else "1",
            time=f"{verdict.seconds:.3f}",
        )
        for case in cases:
            entry = ET.SubElement(suite, "testcase", name=case["name"], classname=verdict.file.stem)
            if verdict.document is None:
                ET.SubElement(entry, "error", message=verdict.error)
            elif not case["passed"]:
                ET.SubElement(entry, "failure", message=_why(case))
    ET.indent(root)
    atomic_write(path, ET.tostring(root, encoding="UTF-8", xml_declaration=True))


def _why(case: CaseDocument) -> str:
    missed = [f"{check['text']}: {check['found']}" for check in case["checks"] if not check["held"]]
    return str(case["error"]) if case["error"] else "; ".join(missed)
