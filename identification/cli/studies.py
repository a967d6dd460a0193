"""Commands that find parameters and judge them, and what to record for that: calibrate, validate, tune, design."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from fmus.errors import FmuError
from orchestrator.cli.options import Isolate
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from identification.design.summary import DesignSummary
    from identification.experiments.summary import ExperimentsSummary
    from identification.fits import FitSummary
    from identification.output_error.results import OutputErrorSummary
    from identification.results import Summary, ValidationSummary, VerdictSummary
    from identification.subspace.summary import SubspaceSummary
    from identification.tuning.summary import RigSummary, TuningSummary

app = typer.Typer()

Data = Annotated[Path | None, typer.Option("--data", help="Folder (or file) of recordings.")]


@command(app)
def calibrate(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study file.")],
    *,
    data: Data = None,
    jobs: Annotated[
        int | None, typer.Option("-j", "--jobs", min=1, help="Simulations at a time; one a processor by default.")
    ] = None,
    out: Out = None,
    isolate: Isolate,
) -> Answer:
    """Traces to calibrated FMUs, parameters.ssv, summary.json and report.html.

    Exit code 1 when the median FIT misses the study's `at_least`, or a claim does not come out as the study states.
    """
    from identification.calibrate import calibrate_study
    from identification.estimation.stopped import EstimationFailed, EstimationInterrupted
    from orchestrator.processes.pool import at_most
    from orchestrator.results import default_folder

    folder = out or default_folder(study)
    try:
        with terminal.bar(study.stem) as move, at_most(jobs):
            document = calibrate_study(study, data, folder, move, isolate.isolation())
    except EstimationInterrupted as stop:
        judged = "" if "choice" in stop.result.summary else ", without intervals and not validated"
        line = f"interrupted; what had been estimated is in {folder}{judged}"
        return Answer(stop.result.summary, held=False, interrupted=line)
    except KeyboardInterrupt:
        line = "interrupted before anything was estimated; nothing is written"
        return Answer({"interrupted": True}, held=False, interrupted=line)
    except EstimationFailed as stop:
        fix = f"{stop.fix}; what had been estimated is in {folder}, not validated".removeprefix("; ")
        raise FmuError(stop.place, stop.problem, fix) from stop
    fmus = f"FMUs in {folder / 'fmus'}, " if (folder / "fmus").is_dir() else ""
    fit = document["fit"]
    shown: list[Listing | str] = [
        _table(document),
        *_candidates(document),
        *_windows(document),
        *_given(document),
        *_fits({side: fit[side] for side in ("train", "validation") if side in fit}, fit.get("compared", {})),
        *_remarks(document),
    ]
    shown.append(f"{fmus}report in {folder / 'report.html'}")
    return _judged(document, document.get("verdict"), shown)


@command(app)
def validate(
    terminal: Terminal,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that `calibrate` wrote.")],
    *,
    data: Annotated[Path, typer.Option("--data", help="Folder (or file) of other recordings.")],
    out: Out = None,
    isolate: Isolate,
) -> Answer:
    """Judge a calibrated result on other traces; exit code 1 when it misses the study's target."""
    from identification.validation import validate_result

    target = out or folder / "validation"
    with terminal.bar("validating") as move:
        document = validate_result(folder, data, target, move, isolate.isolation())
    shown: list[Listing | str] = [*_fits(document["fit"], {}), *_remarks(document)]
    shown.append(f"report in {target / 'report.html'}")
    return _judged(document, document["verdict"], shown)


@command(app)
def tune(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study file of `method: tune`.")],
    *,
    isolate: Isolate,
    out: Out = None,
) -> Answer:
    """A controller's values for several plants at once, written into its FMU, with summary.json and report.html.

    Exit code 1 when no values hold all hard goals (those that miss least are shown, and the goals that bind), or what
    is expected of them on the nonlinear rig (`judged_on`).
    """
    from identification.calibrate import study_without_data
    from orchestrator.results import default_folder

    folder = out or default_folder(study)
    with terminal.bar(study.stem) as move:
        document = study_without_data("tune", study, folder, move, isolate.isolation())
    tuned = cast("TuningSummary", document)
    shown: list[Listing | str] = [_parameters(document), _goals(tuned)]
    shown += [_rig(rig) for rig in tuned.get("rigs", [])]
    shown += [f"{name}: {figure:.6g}" for name, figure in tuned.get("design", {}).items()]
    shown += [*_draws(tuned), *_remarks(document)]
    shown.append(f"FMUs in {folder / 'fmus'}, report in {folder / 'report.html'}")
    return _judged(document, document.get("verdict"), shown)


@command(app)
def design(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study file of `method: design`.")],
    *,
    out: Out = None,
) -> Answer:
    """The next experiments: what to excite a rig with so that a calibration's intervals become smallest, within limits.

    Writes a scenario that runs them, a playback file of each, and the study that calibrates by their recordings.
    """
    from identification.calibrate import study_without_data
    from identification.design.written import CALIBRATION, EXPERIMENTS

    folder = out or Path("out") / study.stem
    with terminal.bar(study.stem) as move:
        document = study_without_data("design", study, folder, move)
    designed = cast("DesignSummary", document)
    shown: list[Listing | str] = [_half_widths(designed), *_experiments(designed), *_remarks(document)]
    shown += [f"worst half-width, {name}: {100 * x:.3g} %" for name, x in designed["worst"].items() if x is not None]
    sought = designed.get("duration")
    shown += [sought["said"]] if sought else []
    shown.append(
        f"{folder / EXPERIMENTS} runs them, {folder / CALIBRATION} calibrates; report in {folder / 'report.html'}"
    )
    return Answer(document, shown, held=not sought or sought["reached"])


def _half_widths(document: DesignSummary) -> Listing:
    """Half-widths of the intervals: known, of other experiments, of the design."""
    entries = document["half_widths"]
    others = list(next(iter(entries.values()))["compared"])
    rows = []
    for name, entry in entries.items():
        widths = (entry["before"], *(entry["compared"][other] for other in others), entry["after"])
        cells = ("-" if width is None else f"{width:.3g}" for width in widths)
        rows.append((name, f"{document['parameters'][name]['value']:.5g}", *cells, entry["unit"]))
    title = "half-widths of the 95 % intervals"
    return Listing(("parameter", "value", "before", *others, "design", "unit"), rows, title, figures=True)


def _experiments(document: DesignSummary) -> list[str]:
    lines = []
    for name, one in document["experiments"].items():
        values = ", ".join(f"{key} {_cell('', value)}" for key, value in one["values"].items())
        lines.append(f"{name}: {values}")
    return lines


def _goals(document: TuningSummary) -> Listing:
    """Each goal, its worst and best figure over the plants, and whether it is held."""
    rows = []
    for goal in document["goals"]:
        found = [figure for figure in goal["figures"].values() if figure is not None]
        span = f"{min(found):.4g} to {max(found):.4g}" if found else "-"
        held = {True: "held", False: "missed", None: goal["kind"]}[goal["held"]]
        rows.append((goal["goal"], span, held))
    return Listing(("goal", "over the plants", ""), rows)


def _draws(document: TuningSummary) -> list[Listing | str]:
    """Which share of the draws that nothing was fitted to is stable, and holds each goal."""
    from identification.tuning.summary import share_words

    if "draws" not in document:
        return []
    draws = document["draws"]
    unseen = draws["unseen"]
    rows = [("stable", share_words(unseen["stable"]))]
    rows += [(goal["goal"], share_words(goal["held"])) for goal in unseen["goals"] if goal["held"] is not None]
    rows.append(("all hard goals", share_words(unseen["held"])))
    title = f"{draws['count']:,} draws that nothing was fitted to"
    return [Listing(("holds", "share (95 % interval)"), rows, title)]


def _rig(rig: RigSummary) -> Listing:
    """Each case on the rig, and what of it did not hold."""
    rows = []
    for case in rig["cases"]:
        lost = [f"{check['text']}: {check['found']}" for check in case["checks"] if not check["held"]]
        held = f"{len(case['checks']) - len(lost)} of {len(case['checks'])}"
        rows.append((case["name"], held, "; ".join(lost) or case["error"] or "held"))
    return Listing(("case", "expectations", ""), rows, rig["scenario"])


def _judged(
    document: Summary | ValidationSummary, verdict: VerdictSummary | None, shown: list[Listing | str]
) -> Answer:
    """The answer, with the verdict as its last line."""
    said = [verdict["said"]] if verdict and verdict["said"] else []
    return Answer(document, [*shown, *said], verdict is None or verdict["held"])


def _table(document: Summary) -> Listing:
    """What there is to tell first: models, claims or parameters."""
    if "models" in document:
        return _models(cast("SubspaceSummary", document))
    return _claims(cast("ExperimentsSummary", document)) if "claims" in document else _parameters(document)


def _parameters(document: Summary) -> Listing:
    from identification.result_sections import parameter_rows

    headers, rows = parameter_rows(document["parameters"])
    return Listing(headers, [list(map(_cell, headers, row)) for row in rows], document["title"], figures=True)


def _candidates(document: Summary) -> list[Listing]:
    """How candidates came out, of a study that has some."""
    from identification.output_error.choice.summary import candidate_rows

    choice = cast("OutputErrorSummary", document).get("choice")
    if choice is None:
        return []
    headers, rows = candidate_rows(choice)
    cells = [["-" if cell is None else str(cell) for cell in row] for row in rows]
    title = f"candidates, by {', '.join(choice['signals'])}: criteria over the least, errors over {choice['chosen']}'s"
    return [Listing(headers, cells, title, figures=True)]


def _windows(document: Summary) -> list[str]:
    """How recordings have chosen windows, and what became of segments of these, where that is."""
    from identification.output_error.results import shooting_words, windows_words

    if document["method"] != "output-error":
        return []
    made = cast("OutputErrorSummary", document)
    windows, shot = made.get("windows"), made["search"].get("shooting")
    said = [windows_words(windows)] if windows else []
    return [f"note: {words}" for words in (*said, *([shooting_words(shot)] if shot else []))]


def _cell(header: str, value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{2 if header.startswith('±') else 5}g}"
    return "-" if value is None else str(value)


def _models(document: SubspaceSummary) -> Listing:
    from identification.subspace.summary import model_rows

    headers, rows = model_rows(document)
    cells = [[f"{cell:.4f}" if isinstance(cell, float) else str(cell or "none") for cell in row] for row in rows]
    title = "median FIT, and the worst of the traces that models are compared on"
    return Listing(headers, cells, title)


def _claims(document: ExperimentsSummary) -> Listing:
    rows = [(one.statement, one.outcome, f"{one.count} of {len(one.comparisons)}") for one in document["claims"]]
    return Listing(("claim", "outcome", "comparisons"), rows, document["title"])


def _fits(sides: Mapping[str, FitSummary | None], compared: Mapping[str, FitSummary]) -> list[str]:
    from identification.fits import told

    lines = []
    for side, fit in sides.items():
        if fit is not None:
            worst = f", worst {told(fit['worst'])}" if fit.get("worst") else ""
            traces = "1 trace" if len(fit["traces"]) == 1 else f"{len(fit['traces'])} traces"
            lines.append(f"median FIT, {side}: {_figure(fit['median'])} ({traces}){worst}")
            outputs = fit.get("outputs", {})
            lines += [f"  {name}: {_figure(value)}" for name, value in outputs.items() if len(outputs) > 1]
    return lines + [
        f"median FIT of {name}: {_figure(fit['median'])}, worst {told(fit.get('worst'))}"
        for name, fit in compared.items()
    ]


def _figure(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"


def _given(document: Summary) -> list[str]:
    """What the intervals take for right, of a method that says so."""
    if document["method"] != "output-error":
        return []
    return [f"± 95 %: {cast('OutputErrorSummary', document)['uncertainty']['given']}"]


def _remarks(document: Summary | ValidationSummary) -> list[str]:
    """What a reader of the figures must know, and what of the recordings was converted without a doubt."""
    from orchestrator.crossing import notes

    return [*(f"warning: {one}" for one in document["warnings"]), *notes(document.get("units", []))]
