"""The root of the command line: the version, and the commands that other packages add."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeGuard

import typer
from typer.core import TyperGroup
from typer.main import get_command

from fmus.errors import ServotwinError
from orchestrator.cli.terminal import show
from orchestrator.plugins import plugins


class Commands(TyperGroup):
    """Our commands, and those that other packages add: each a `typer.Typer`, none in place of one of ours."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        own = super().get_command(ctx, cmd_name)
        return get_command(_added()[cmd_name]) if own is None and cmd_name in _added() else own

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if Path(args[0]).is_file():
            ctx.fail(f"'{args[0]}' is no command; give it to one: servotwin {_command_for(Path(args[0]))} {args[0]}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        return list(dict.fromkeys((*super().list_commands(ctx), *_added())))


def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="The version; with -v what a fault report needs.")] = False,
    verbose: Annotated[bool, typer.Option("-v", hidden=True)] = False,
) -> None:
    """Calibrated digital twins of servo-driven mechanisms as FMUs."""
    if version:
        from orchestrator.installation import details
        from orchestrator.results import version_of

        for line in details() if verbose else [f"servotwin {version_of('servotwin')}"]:
            show(line)
        raise typer.Exit
    if verbose or context.invoked_subcommand is None:
        context.fail("Give a command; -v goes after it, or with --version.")


def _command_for(file: Path) -> str:
    """The command that takes a file."""
    if file.suffix not in (".yaml", ".yml"):
        return "build" if file.suffix == ".py" else "info"
    from orchestrator.yaml_file import KINDS, keys

    try:
        return next((KINDS[key][1] for key in KINDS if key in keys(file)), "run")
    except ServotwinError:
        return "run"


def _added() -> dict[str, typer.Typer]:
    return plugins("servotwin.commands", _is_app)


def _is_app(loaded: object) -> TypeGuard[typer.Typer]:
    return isinstance(loaded, typer.Typer)
