"""Commands on the cache of built FMUs: cache info, clear."""

from __future__ import annotations

import typer

from orchestrator.cli.terminal import Answer, Terminal, command, facts

app = typer.Typer(no_args_is_help=True, help="Look at the cache of built FMUs, and empty it.")


@command(app, "info")
def cache_info(terminal: Terminal) -> Answer:
    """Where built FMUs are kept, how many there are, and their size."""
    from fmus.packaging import cache

    kept = cache.current()
    entries = [] if kept is None else kept.entries()
    document = {
        "folder": None if kept is None else str(kept.folder),
        "entries": len(entries),
        "bytes": sum(entry.size for entry in entries),
        "limit": 0 if kept is None else kept.largest,
    }
    return Answer(document, [_switched_off() if kept is None else facts(document)])


@command(app, "clear")
def cache_clear(terminal: Terminal) -> Answer:
    """Remove all entries; FMUs are built anew from then on."""
    from fmus.packaging import cache

    kept = cache.current()
    removed = 0 if kept is None else kept.clear()
    document = {"folder": None if kept is None else str(kept.folder), "removed": removed}
    return Answer(document, [_switched_off() if kept is None else f"{removed} entries removed from {kept.folder}"])


def _switched_off() -> str:
    from fmus.packaging.cache import VARIABLE

    return f"the cache is switched off by {VARIABLE}"
