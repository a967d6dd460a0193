"""The command that tells editors what YAML files may say: schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from fmus.errors import InputError
from orchestrator.cli.tables import SCHEMAS
from orchestrator.cli.terminal import Answer, Terminal, command
from orchestrator.documents.reference import Schema

app = typer.Typer()


def _scenario() -> Any:
    from orchestrator.scenario.schema import ScenarioBlock

    return ScenarioBlock


def _part() -> Any:
    from orchestrator.scenario.schema import ScenarioPartBlock

    return ScenarioPartBlock


def _procedure() -> Any:
    from orchestrator.batch.procedure import ProcedureBlock

    return ProcedureBlock


def _sweep() -> Any:
    from orchestrator.batch.sweep.points.schema import SweepBlock

    return SweepBlock


SCHEMAS |= {"scenario": _scenario, "part": _part, "procedure": _procedure, "sweep": _sweep}


@command(app)
def schema(
    terminal: Terminal,
    kind: Annotated[str, typer.Argument(help="scenario, part, study, design, procedure or sweep.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write it there.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="A page for people about every key, instead.")] = False,
) -> Answer:
    """JSON Schema (draft 2020-12) of a kind of YAML file, with which editors complete and check it."""
    from fmus.files import atomic_write
    from orchestrator.documents.reference import page

    if kind not in SCHEMAS:
        raise InputError(f"schema '{kind}'", "is not known", f"choose {' or '.join(SCHEMAS)}")
    document = schema_of(kind)
    text = page(document).rstrip() if markdown else json.dumps(document, indent=2)
    if out is None:
        return Answer(document, [text])
    atomic_write(out, f"{text}\n".encode())
    return Answer(document, [f"written to {out}"])


def schema_of(kind: str) -> Schema:
    """The JSON Schema of a kind of YAML file."""
    from pydantic import TypeAdapter

    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"servotwin {kind}"}
    return dialect | {
        name: part for name, part in TypeAdapter(SCHEMAS[kind]()).json_schema().items() if name != "title"
    }
