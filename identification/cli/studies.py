"""Commands that fit parameters and judge them: calibrate, validate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

app = typer.Typer()

Data = Annotated[Path | None, typer.Option("--data", help="Folder (or file) of recordings.")]


@command(app)
def calibrate(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study file.")],
    data: Data = None,
    out: Out = None,
) -> Answer:
    """Traces to calibrated FMUs, parameters.ssv, summary.json and report.html.

    Exit code 1 when a claim does not come out as the study states.
    """
    from identification.calibrate import calibrate_study

    folder = out or Path("out") / study.stem
    with terminal.bar(study.stem) as move:
        document = calibrate_study(study, data, folder, move)
    shows = next((show for key, show in _RESULTS.items() if key in document), _parameters)
    fmus = f"FMUs in {folder / 'fmus'}, " if (folder / "fmus").is_dir() else ""
    shown: list[Listing | str] = [shows(document), *_fits(document), *_warnings(document)]
    shown.append(f"{fmus}report in {folder / 'report.html'}")
    return Answer(document, shown, document.get("as_stated", True))


@command(app)
def validate(
    terminal: Terminal,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that `calibrate` wrote.")],
    data: Annotated[Path, typer.Option("--data", help="Folder (or file) of other recordings.")],
    out: Out = None,
) -> Answer:
    """Judge a calibrated result on other traces; exit code 1 when it misses the study's target."""
    from identification.calibrate import validate_result

    target = out or folder / "validation"
    with terminal.bar("validating") as move:
        document = validate_result(folder, data, target, move)
    shown = [*_fits(document), *_warnings(document), f"report in {target / 'report.html'}"]
    return Answer(document, shown, document["held"])


def _parameters(document: dict[str, Any]) -> Listing:
    from identification.output_error.report import parameter_rows

    headers, rows = parameter_rows(document)
    return Listing(headers, [list(map(_cell, headers, row)) for row in rows], document["title"], figures=True)


def _cell(header: str, value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{2 if header.startswith('±') else 5}g}"
    return "-" if value is None else str(value)


def _models(document: dict[str, Any]) -> Listing:
    """Order and median FIT of each output, on fitted and on unseen traces, of every model of a subspace study."""
    outputs = list(document["fit"]["train"]["outputs"])
    sides = {"fitted": "train", "unseen": "validation"}
    rows = []
    for name, model in document["models"].items():
        fits = [model["fit"][group] for group in sides.values()]
        values = [_figure(fit["outputs"][output] if fit else None) for fit in fits for output in outputs]
        rows.append([name, str(model["order"]), *values])
    headers = ("model", "order", *(f"{output}, {side}" for side in sides for output in outputs))
    return Listing(headers, rows, "median FIT")


def _claims(document: dict[str, Any]) -> Listing:
    rows = []
    for claim in document["claims"]:
        held = sum(comparison["held"] for comparison in claim["comparisons"])
        rows.append((claim["statement"], claim["outcome"], f"{held} of {len(claim['comparisons'])}"))
    return Listing(("claim", "outcome", "comparisons"), rows, document["title"])


_RESULTS = {"models": _models, "claims": _claims}  # what tells a summary's kind, and its table


def _fits(document: dict[str, Any]) -> list[str]:
    lines = []
    for group, judged in document["fit"].items():
        if group == "compared":
            lines += [f"median FIT of {name}: {_figure(other['median'])}" for name, other in judged.items()]
        elif judged is not None:
            lines.append(f"median FIT, {group}: {_figure(judged['median'])} ({len(judged['traces'])} traces)")
            outputs = judged.get("outputs", {})
            lines += [f"  {name}: {_figure(value)}" for name, value in outputs.items() if len(outputs) > 1]
    return lines


def _figure(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"


def _warnings(document: dict[str, Any]) -> list[str]:
    return [f"warning: {warning}" for warning in document["warnings"]]
