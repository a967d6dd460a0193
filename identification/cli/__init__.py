"""The console script: the commands, run under guard; they are loaded in the process that does the work."""

from __future__ import annotations

import gc
import sys
from typing import TYPE_CHECKING, Any

from orchestrator.display.stdout import unwritable
from orchestrator.guard import guarded

if TYPE_CHECKING:
    from identification.cli.commands import app

__all__ = ["app", "main"]


def main() -> None:
    """Entry point of `servotwin`."""
    try:
        guarded(_command)
    finally:
        gc.freeze()  # Python would search all that the libraries have made for garbage, for half a second


def _command() -> None:
    try:
        from identification.cli.commands import app

        try:
            app()
        except OSError as problem:  # of what the command line itself tells, such as its help
            print(f"servotwin: {(error := unwritable(problem))}", file=sys.stderr)
            sys.exit(error.exit_code)
    except Exception as error:  # of the command line itself: what a command raises it tells
        from fmus.errors import InternalError

        if "-vv" in sys.argv:
            sys.excepthook(type(error), error, error.__traceback__)
        print(f"servotwin: {InternalError.of(error)}", file=sys.stderr)
        sys.exit(InternalError.exit_code)


def __getattr__(name: str) -> Any:
    if name != "app":
        raise AttributeError(f"module 'identification.cli' has no attribute '{name}'")
    from identification.cli.commands import app

    return app
