"""New references written where they differ from the old ones, with a page that shows both; nothing is lost."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from fmus.errors import InputError
from fmus.files import atomic_writes
from orchestrator.comparison.proposal import ChangeKind, NewReference, Proposal
from orchestrator.display import characters
from orchestrator.display.titles import with_unit
from orchestrator.processes.interrupts import whole
from orchestrator.report import Chart, Curve, Panel, Report, Section
from orchestrator.report.content import CalloutKind
from orchestrator.results import result_folder, versions, write_json

HEADERS = ("case", "signal", "largest difference", "at [s]", "tolerance", "in tolerances")


def accept_proposals(
    proposals: Sequence[Proposal], out: Path, every: bool = False, write: bool = True
) -> list[NewReference]:
    """Write the new references, where they differ from the old ones, and a page that shows both; those written.

    A folder of results takes the page, and the old references as they were; none is replaced before that is there, and
    none where one cannot be.

    Args:
        every: whether those that agree with the old ones are written, too.
        write: whether any is; otherwise the page alone, and those that would be.

    Raises:
        InputError: two scenarios would write one file, or a place cannot be written.
    """
    _check_owners(proposals)
    made = [new for proposal in proposals for new in proposal.references]
    chosen = [new for new in made if every or new.change is not ChangeKind.SAME]
    _leave(out, proposals, chosen if write else [])
    if not write:
        return chosen
    try:
        with whole():
            atomic_writes({new.file: new.content for new in chosen})
    except InputError:
        _leave(out, proposals, [])  # which says that none is written
        raise
    return chosen


def _leave(out: Path, proposals: Sequence[Proposal], chosen: Sequence[NewReference]) -> None:
    """The folder of results, with what the chosen references replace."""
    written = {new.file for new in chosen}
    with result_folder(out, [proposal.scenario for proposal in proposals]) as folder:
        for number, proposal in enumerate(proposals, 1):
            for new in proposal.references:
                if new.file in written and new.file.exists():
                    kept = folder / "replaced" / f"{number}_{proposal.scenario.stem}" / new.file.name
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(new.file, kept)
        write_json(folder / "manifest.json", document_of(proposals, written))
        page(proposals, written).write(folder / "report.html")


def _check_owners(proposals: Sequence[Proposal]) -> None:
    owners: dict[Path, Path] = {}
    for new in (new for proposal in proposals for new in proposal.references):
        owner = owners.setdefault(new.file.resolve(), new.scenario.resolve())
        if owner != new.scenario.resolve():
            raise InputError(new.file, f"would be written by {owner} and by {new.scenario}", "rename one of them")


def document_of(proposals: Sequence[Proposal], written: Collection[Path]) -> dict[str, object]:
    """What was accepted, as plain values; which references were `written`."""
    return {
        "title": "References",
        "references": [_document(new, new.file in written) for proposal in proposals for new in proposal.references],
        "unused": [file for proposal in proposals for file in proposal.unused],
        "doubts": [f"{proposal.scenario}: {line}" for proposal in proposals for line in proposal.doubts],
        "versions": versions(),
    }


def _document(new: NewReference, written: bool) -> dict[str, object]:
    return {
        "scenario": new.scenario,
        "case": new.case,
        "file": new.file,
        "change": new.change,
        "why": new.why,
        "written": written,
        "samples": len(new.run),
        "kept": len(new.kept),
        "bytes": len(new.content),
        "signals": new.partings,
    }


def rows(new: NewReference) -> Iterator[tuple[str, str, str, str, str, str]]:
    """A row under `HEADERS` of every signal that can be compared with the old reference."""
    for one in new.partings:
        unit = "" if one.unit in ("", "1") else f" {one.unit}"
        yield (
            new.case,
            one.signal,
            f"{one.largest:.4g}{unit}",
            f"{one.at:.4g}",
            f"{one.tolerance:.4g}{unit}",
            f"{one.times:.3g}",
        )


def size(new: NewReference) -> str:
    """How much of the run it holds, in words."""
    return f"{len(new.kept):,} of {len(new.run):,} samples, {len(new.content):,} bytes"


def drawn(new: NewReference) -> Iterator[str]:
    """A drawing, in characters, of each signal that parts from the old reference."""
    for one in new.partings:
        if one.beyond and new.old is not None and new.change is not ChangeKind.SAME:
            old, run, name = new.old, new.run, one.signal
            title = f"{new.case}: {name} [{one.unit or '1'}]"
            yield characters.plot(title, (old.time, old[name]), (run.time, run[name]))


def page(proposals: Sequence[Proposal], written: Collection[Path]) -> Report:
    """Numbers and curves of every new reference over the old one."""
    report = Report("References", "New ones against those before")
    for proposal in proposals:
        section = report.section(f"{proposal.title} ({proposal.scenario})")
        section.warnings(f"{line}." for line in proposal.doubts)
        section.warnings(f"No case asks for {file}." for file in proposal.unused)
        if not proposal.references:
            section.paragraph("No case asks for an accepted reference.")
        for new in proposal.references:
            _show(section, new, new.file in written)
    return report


def _show(section: Section, new: NewReference, written: bool) -> None:
    kind: CalloutKind = "warning" if new.change in (ChangeKind.OTHER, ChangeKind.UNFIT) else "ok"
    done = "written" if written else "not written"
    section.callout(kind, f"Case {new.case}: {new.change}{f', {new.why}' if new.why else ''}; {done}.")
    section.paragraph(f"{new.file}: {size(new)}.")
    if new.partings:
        section.table(HEADERS, list(rows(new)))
    panels = [Panel(with_unit(name, new.run.unit(name)), list(_curves(new, name))) for name in new.run.names]
    section.figure(Chart(panels, legend=True), new.case)


def _curves(new: NewReference, name: str) -> Iterator[Curve]:
    """The old reference broad and pale, the run on top of it."""
    if new.old is not None and name in new.old.names:
        yield Curve("old", new.old.time, new.old[name], tone="measured")
    yield Curve("new", new.run.time, new.run[name])
