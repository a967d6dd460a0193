"""The report of a run: how its expectations turned out, its curves with what was asked of them, and what ran."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress

import numpy as np

from fmus.errors import TraceError
from fmus.files import sha256
from orchestrator.crossing import Crossing
from orchestrator.display.table import Cell, text
from orchestrator.display.titles import with_unit
from orchestrator.fmi.interface import Port
from orchestrator.report import Band, Chart, ChartLine, Curve, Panel, Report, Section, figures
from orchestrator.report.chart import Style
from orchestrator.report.checks import CheckRow, Checks
from orchestrator.report.content import CalloutKind
from orchestrator.results import versions
from orchestrator.scenario import accounts
from orchestrator.scenario.diagram import source_of, wiring_of
from orchestrator.scenario.expectations import Check, OnSignal
from orchestrator.scenario.expectations.limits import Near, OneSided
from orchestrator.scenario.expectations.reference import Against
from orchestrator.scenario.expectations.stochastic import Often
from orchestrator.scenario.run import CaseResult, CaseState, ScenarioResult
from orchestrator.scenario.scenario import Case
from orchestrator.system import Endpoint, System
from orchestrator.trace import Trace

PLOTTED_CASES = 12
CHANGES = 50  # that are listed
OPEN_SIGNALS = 8  # of a case, that are seen without a click


def interruption(result: ScenarioResult) -> str:
    """Where a run was interrupted."""
    last = [case for case in result.cases if case.state is not CaseState.NOT_RUN][-1]
    done = last.state is CaseState.DONE
    return f"interrupted after case {last.name}" if done else f"{last.how_far} of case {last.name}"


def report(result: ScenarioResult, received: Collection[str] = ()) -> Report:
    """The whole report; without curves of an interrupted run, which is to end at once.

    Args:
        received: inputs that a bus has driven, whose stimuli only stand in for it.
    """
    page = Report(result.scenario.title, result.scenario.description)
    _verdict(page.section("Expectations"), result)
    tell_units(page, result.crossings)
    if not result.interrupted:
        _draw(page.section("Traces"), result, received)
    if result.system is not None:
        section = page.section("System")
        if len(result.scenario.by_system()) > 1:
            section.paragraph(f"That of case {result.cases[0].name}; others have components of their own.")
        section.figure(wiring_of(result, result.system, received), "Components, their steps, and what is connected")
        _parameters(section, result, result.system)
    _changes(page, result)
    _stepping(page.section("Step statistics"), result)
    _provenance(page.section("Provenance"), result)
    return page


def _verdict(section: Section, result: ScenarioResult) -> None:
    if result.interrupted:
        section.callout("warning", f"The run was {interruption(result)}.")
    else:
        section.callout("ok" if result.passed else "error", "All held." if result.passed else "Not all held.")
    section.warnings(
        f"Case {case.name}: {case.error or case.ended}."
        for case in result.cases
        if case.ended or case.state is CaseState.FAILED
    )
    section.warnings(f"{line}." for line in result.scenario.held)
    rows = [row for case in result.cases for row in _checks(case)]
    section.content.append(Checks(("case", "expectation", "found", "margin"), rows))
    section.warnings(
        f"Case {case.name}: {check.text}: {check.doubt}."
        for case in result.cases
        for check in case.checks
        if check.doubt
    )


def _checks(case: CaseResult) -> Iterator[CheckRow]:
    """A row a check, its parts below it; one that says how far the case came where it has none."""
    if not case.checks:
        yield CheckRow("ok" if case.passed else "error", case.name, "–", case.how_far)
    for check in case.checks:
        yield from _check(case.name, check, 0)


def _check(case: str, check: Check, depth: int) -> Iterator[CheckRow]:
    kind: CalloutKind = "ok" if check.held else "error" if check.needed else "warning"
    margin = None if check.margin is None else f"{text(float(f'{check.margin:.3g}'))} {check.unit}".strip()
    yield CheckRow(kind, case, check.text, check.found, margin, depth)
    for part in check.parts:
        yield from _check(case, part, depth + 1)


def _stepping(section: Section, result: ScenarioResult) -> None:
    """Whose time the steps took, how often cycles were iterated, and what FMUs have warned of."""
    section.paragraph(accounts.sentence_of(result))
    rows = accounts.rows_of(result)
    section.table(accounts.HEADERS, rows)
    if rows:
        shares = {name: percent for name, *_, percent in rows}
        section.figure(figures.bars({"share": shares}, quantity="Share of the time", unit="%"))
    told = [(case.name, case.result) for case in result.cases if case.result is not None]
    if any(made.iterations for _, made in told):
        iterations = [(name, made.iterations, made.iterations / max(made.account.steps, 1)) for name, made in told]
        section.table(["case", "iterations of cycles", "a step"], iterations)
    warned = [(name, part, count) for name, made in told for part, count in made.warnings.items() if count]
    if warned:
        section.table(["case", "component", "warnings of its FMU"], warned)
    if result.keeping.profile is not None:
        section.paragraph("Each step is in profile.json, a trace for Perfetto or the browser's own viewer.")


def _changes(page: Report, result: ScenarioResult) -> None:
    """A section about what was changed while it ran, where something was, and how a run in real time kept up."""
    live = [(case.name, case.result) for case in result.cases if case.result is not None]
    paced = [(name, made.deadlines) for name, made in live if made.deadlines is not None]
    rows = [
        (name, change.time, change.name, str(change.before), str(change.value), change.by)
        for name, made in live
        for change in made.changes
    ]
    if not (paced or rows):
        return
    section = page.section("Real time")
    for name, deadlines in paced:
        section.paragraph(f"Case {name}: {deadlines.sentence()}")
    if rows:
        headers = ["case", "time [s]", "changed", "from", "to", "by"]
        more = f"The first {CHANGES} of {len(rows):,}; the manifest has all." if len(rows) > CHANGES else ""
        section.table(headers, rows[:CHANGES], caption=more)


def tell_units(page: Report, crossings: Sequence[Crossing]) -> None:
    """A section about what was converted, where something was; what is doubtful first."""
    if not crossings:
        return
    section = page.section("Units")
    section.warnings(str(one) for one in crossings if one.doubtful)
    sure = [(str(one),) for one in crossings if not one.doubtful]
    if sure:
        section.table(("how values got to their units",), sure)


def _draw(section: Section, result: ScenarioResult, received: Collection[str]) -> None:
    """The curves of each case: what is judged first, then what else is recorded and what drives it."""
    shown = [(case, made) for case, made in _pairs(result) if made.result]
    if len(shown) > PLOTTED_CASES:
        section.paragraph(f"The first {PLOTTED_CASES} of {len(shown)} cases.")
    for case, made in shown[:PLOTTED_CASES]:
        panels = [*_signals(case, made, result.system), *_inputs(result, made.trace, received)]
        if not panels and not made.trace.texts:
            section.paragraph(f"Case {made.name} has recorded nothing.")
            continue
        if len(result.cases) > 1:
            section.subheading(made.name)
        _texts(section, made)
        if not panels:
            continue
        section.figure(Chart(panels[:OPEN_SIGNALS]), f"Case {made.name}")
        if rest := panels[OPEN_SIGNALS:]:
            section.folded(f"{made.name}: {len(rest)} more signals").figure(Chart(rest), f"Case {made.name}")


def _texts(section: Section, made: CaseResult) -> None:
    """When texts changed, and into what."""
    trace = made.trace
    rows: list[list[Cell]] = []
    for name in trace.texts:
        changed = np.flatnonzero(np.diff(trace[name], prepend=np.inf))
        words = trace.rows(np.isin(np.arange(len(trace)), changed[:CHANGES])).words(name)
        rows += [[name, float(trace.time[row]), text] for row, text in zip(changed.tolist(), words, strict=False)]
        if len(changed) > CHANGES:
            section.paragraph(f"{name} changed {len(changed) - 1:,} times; the first {CHANGES} texts are listed.")
    if rows:
        section.table(["text", "from [s]", "is"], rows)


def _signals(case: Case, made: CaseResult, system: System | None) -> Iterator[Panel]:
    """A panel a recorded signal, with the references, tubes and limits that it is judged by."""
    trace = made.trace
    trace = trace.numbers
    for name in dict.fromkeys([*(name for name in case.looked_at if name in trace.names), *trace.names]):
        port = None if system is None else _port(system, name)
        style: Style = "steps" if port is not None and port.stepwise else "line"
        leaves = [leaf for expected in case.expected for leaf in expected.leaves]
        asked = [one for one in leaves if isinstance(one, OnSignal) and one.signal == name]
        marks: list[ChartLine] = []
        bands: list[Band] = []
        curves = [Curve("run", trace.time, trace[name], style)]
        for expected in asked:
            with suppress(TraceError):  # a reference that ends before the record does; the verdict says so
                _add_asked(expected, made, curves, bands, marks)
        yield Panel(with_unit(name, trace.unit(name)), curves, marks, bands)


def _add_asked(
    expected: OnSignal, made: CaseResult, curves: list[Curve], bands: list[Band], marks: list[ChartLine]
) -> None:
    """What an expectation asks of a signal, as it is drawn."""
    trace, condition = made.trace, expected.condition
    condition = condition.condition if isinstance(condition, Often) else condition
    first, last = (float(trace.time[i]) for i in (0, -1)) if len(trace) else (0.0, 0.0)
    start = first if expected.after is None else max(expected.after, first)
    stop = last if expected.before is None else min(expected.before, last)
    if not start < stop:  # the run ended before what was asked of it
        return
    if isinstance(condition, OneSided):
        said = f"{condition.side} {float(condition.limit):g}"
        marks.append(ChartLine(float(condition.limit), "y", said, (start, stop)))
    elif isinstance(condition, Near):
        time, target, within = np.array([start, stop]), np.full(2, float(condition.target)), float(condition.within)
        curves.append(Curve("target", time, target, tone="reference"))
        bands.append(Band("tube", time, target - within, target + within))
    elif isinstance(condition, Against):
        if condition.reference.trace is None:
            return
        window = condition.reference.trace.between(start, stop)
        (values,) = window.signals.values()
        curves.append(Curve(condition.reference.name, window.time, values, tone="reference"))
        if (asked := expected.tube(trace, made.draws)) is not None:
            bands.append(Band("tube", asked[0], *asked[1]))
    elif (asked := expected.tube(trace, made.draws)) is not None:
        bounds = [bound for bound in asked[1] if np.any(np.isfinite(bound))]
        curves.extend(Curve("bound", asked[0], bound, tone="reference") for bound in bounds)
        if len(bounds) == 2:
            bands.append(Band("tube", asked[0], *bounds))


def _pairs(result: ScenarioResult) -> list[tuple[Case, CaseResult]]:
    """What was to run with what came of it; on a bus one case alone runs."""
    cases = result.scenario.cases
    if len(cases) == len(result.cases):
        return list(zip(cases, result.cases, strict=True))
    named = {case.name: case for case in cases}
    return [(named[made.name], made) for made in result.cases]


def _inputs(result: ScenarioResult, trace: Trace, received: Collection[str]) -> Iterator[Panel]:
    """A panel a stimulus that no record holds: what drove the system."""
    known = trace.between(-np.inf, float(result.scenario.timing.stop)).time
    for name, stimulus in sorted(result.scenario.stimuli.items()):
        if name in trace.names or name in received or not len(known):
            continue
        port = None if result.system is None else _port(result.system, name)
        values = stimulus.values(known, name)
        values = np.pad(values, (0, len(trace) - len(known)), mode="edge")  # a bench goes on with the last value
        yield Panel(with_unit(name, port.unit if port else None), [Curve("input", trace.time, values, "steps", 1)])


def _port(system: System, name: str) -> Port | None:
    endpoint = Endpoint.parse(name)
    part = system.parts.get(endpoint.component)
    return None if part is None else part.interface.ports.get(endpoint.variable)


def _parameters(section: Section, result: ScenarioResult, system: System) -> None:
    """All that can be set before a run: what it was, and what the FMU says by itself."""
    cases = [case for case, _ in _pairs(result)]
    rows: list[list[Cell]] = []
    for component, part in system.parts.items():
        for port in part.interface.ports.values():
            name = f"{component}.{port.name}"
            given = [{**case.values, **result.overrides}.get(name) for case in cases]
            if port.causality not in ("parameter", "structuralParameter") and all(one is None for one in given):
                continue
            values = list(dict.fromkeys(port.start if one is None else one for one in given))
            shown = ", ".join(_number(one) for one in values)
            set_by = "file" if any(one is not None for one in given) else "FMU"
            rows.append(
                [name, shown, port.unit or "", "--set" if name in result.overrides else set_by, port.description]
            )
    if rows:
        chosen = [row for row in rows if row[3] != "FMU"]
        headers = ["variable", "value", "unit", "set by", "what it is"]
        if chosen:
            section.table(headers, chosen, caption="Parameters and start values that are set, in all cases")
        if rest := [row for row in rows if row[3] == "FMU"]:
            section.folded(f"{len(rest)} parameters keep what their FMUs say").table(headers, rest)


def _number(value: Cell) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _provenance(section: Section, result: ScenarioResult) -> None:
    """What was run from what."""
    assembled = result.assembled
    rows: list[list[Cell]] = [["scenario", result.scenario.path.name, sha256(result.scenario.path)]]
    for name, file in assembled.files.items():
        made = f"model {source_of(result, name)}" if name in assembled.built else file.name
        rows.append([name, made, result.hashes.get(name)])
    rows += [list(row) for row in result.recordings]
    section.table(["what", "from", "SHA-256"], rows)
    if result.overrides:
        section.provenance({f"--set {name}": _number(value) for name, value in result.overrides.items()})
    section.provenance(versions())
