"""The command line. Each command turns its arguments into one call, and its result into a table or a JSON document.

Commands import what they need when they run, so that --help stays fast.
"""

from __future__ import annotations

import gc

import typer

from identification.cli import studies
from orchestrator.cli import bridge, can, scenarios, traces

__all__ = ["app", "main"]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Calibrated digital twins of servo-driven mechanisms as FMUs.",
)
app.add_typer(scenarios.app)
app.add_typer(studies.app)
app.add_typer(traces.app, name="trace")
app.add_typer(can.app, name="can")
can.app.add_typer(bridge.app)


def main() -> None:
    """Entry point of `servotwin`."""
    try:
        app()
    finally:
        gc.freeze()  # Python would search all that the libraries have made for garbage, for half a second
