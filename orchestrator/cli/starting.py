"""The command that writes starting files: init."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from fmus.errors import InputError
from orchestrator.cli.tables import STARTERS, Starter
from orchestrator.cli.terminal import Answer, Terminal, command

app = typer.Typer()

_OURS = "orchestrator.cli.starters"
STARTERS |= {
    "scenario": Starter(_OURS, {"scenario.yaml": "scenario.yaml"}, ("servotwin run scenario.yaml",)),
    "sweep": Starter(
        _OURS, {"scenario.yaml": "scenario.yaml", "sweep.yaml": "sweep.yaml"}, ("servotwin sweep sweep.yaml",)
    ),
    "model": Starter(_OURS, {"model.txt": "my_model.py"}, ("servotwin build my_model.py",)),
    "ci": Starter(_OURS, {"ci.yaml": ".github/workflows/scenarios.yaml"}, ("servotwin test scenarios",)),
    "gitlab-ci": Starter(_OURS, {"gitlab.yaml": ".gitlab-ci.yml"}, ("servotwin test scenarios",)),
}


@command(app)
def init(
    terminal: Terminal,
    kind: Annotated[str, typer.Argument(help="scenario, study, design, sweep, model, ci (GitHub) or gitlab-ci.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.")] = Path(),
) -> Answer:
    """Write commented starting files that run; a file that is there is never replaced."""
    from fmus.files import atomic_write

    if kind not in STARTERS:
        raise InputError(f"init '{kind}'", "is not known", f"choose {' or '.join(STARTERS)}")
    starter = STARTERS[kind]
    written = {out / name: files(starter.package).joinpath(source) for source, name in starter.files.items()}
    for file in written:
        if file.exists():
            raise InputError(file, "is there already", "give --out another folder, or move it away")
    for file, source in written.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, source.read_bytes())
    place = "next:" if out == Path() else f"next, in {out}:"
    shown = [*(f"wrote {file}" for file in written), place, *(f"  {line}" for line in starter.commands)]
    return Answer({"files": [str(file) for file in written], "next": list(starter.commands)}, shown)
