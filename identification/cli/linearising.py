"""The command that makes linear models of systems: linearise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.options import Overrides, overrides
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from identification.linearisation.result import Linearised, ModelSignal

app = typer.Typer()


@command(app)
def linearise(
    terminal: Terminal,
    scenario: Annotated[Path, typer.Argument(help="A scenario file, an SSP, or an FMU.")],
    *,
    at: Annotated[
        str | None, typer.Option("--at", metavar="SECONDS", help="An instant of its run; its start by default.")
    ] = None,
    case: Annotated[str | None, typer.Option("--case", help="The case to take; the first by default.")] = None,
    out: Out = None,
    set_: Overrides = None,
) -> Answer:
    """A wired system, or one FMU, as a linear model about a point of its run: modes, matrices, a `state_space` FMU."""
    from identification.linearisation.linearise import linearise as linearised
    from identification.linearisation.result import FMU
    from orchestrator.results import check_target

    folder = out or Path("out") / f"{scenario.stem}_linear"
    check_target(folder, [scenario])
    with terminal.bar(scenario.stem) as move:
        found = linearised(scenario, at, overrides(set_), move, case)
        found.write(folder)
    signals = [(side, found.inputs if side == "input" else found.outputs) for side in ("input", "output")]
    rows = [_row(side, signal) for side, these in signals for signal in these]
    shown: list[Listing | str] = [
        f"{found.title}: about {found.point}",
        _modes(found),
        Listing(("", "in the model", "of", "counts from"), rows),
        *(f"{name}: by {how}" for name, how in found.by.items()),
        *(f"warning: {remark}" for remark in found.remarks),
        f"{found.model.order} states over {found.model.step:.6g} s, FMU in {folder / FMU}",
    ]
    return Answer(found.summary, shown)


def _modes(found: Linearised) -> Listing:
    rows = [
        (one["mode"], "-" if one["frequency"] is None else f"{one['frequency']:.5g}", _damping(one["damping"]))
        for one in found.summary["modes"]
    ]
    return Listing(("mode", "frequency [Hz]", "damping"), rows)


def _damping(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _row(side: str, signal: ModelSignal) -> tuple[str, str, str, str]:
    return side, signal.name, signal.of, f"{signal.zero:.6g} {signal.unit}".rstrip()
