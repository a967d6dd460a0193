"""The command line. Each command turns its arguments into one call, and its result into a table or a JSON document.

Commands import what they need when they run, so that --help stays fast.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union

import typer

from identification.cli import linearising, studies
from orchestrator.batch.sweep.cli import command as sweep
from orchestrator.cli import (
    bridge,
    cache,
    can,
    references,
    root,
    scenarios,
    schemas,
    ssp,
    starting,
    suite,
    tables,
    traces,
)

if TYPE_CHECKING:
    from orchestrator.formats import Layout
    from orchestrator.results import FileDocument

__all__ = ["app"]

app = typer.Typer(
    cls=root.Commands,
    callback=root.root,
    invoke_without_command=True,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # to draw boxes around options takes longer than all else of --help
)
app.add_typer(scenarios.app)
app.add_typer(references.app)
app.add_typer(suite.app)
app.add_typer(sweep.app)
app.add_typer(studies.app)
app.add_typer(linearising.app)
app.add_typer(schemas.app)
app.add_typer(starting.app)
app.add_typer(traces.app, name="trace")
app.add_typer(can.app, name="can")
app.add_typer(ssp.app, name="ssp")
app.add_typer(cache.app, name="cache")
can.app.add_typer(bridge.app)


def _judge_claims(study: Path, out: Path) -> FileDocument:
    from identification.calibrate import judge_claims

    return judge_claims(study, out)


def _layout_of(study: Path) -> Layout:
    from identification.calibrate import layout_of

    return layout_of(study)


def _studies() -> Any:
    from pydantic import Field

    from identification.study import method, names

    schemas = tuple(method(name).schema for name in names())
    return Annotated[Union[schemas], Field(discriminator="method")]  # noqa: UP007 (made here)


def _designs() -> Any:
    from identification.design.schema import ExperimentDesignBlock

    return ExperimentDesignBlock


tables.JUDGES["claims"] = _judge_claims
tables.LAYOUTS["method"] = _layout_of
tables.SCHEMAS["study"] = _studies
tables.SCHEMAS["design"] = _designs
tables.STARTERS["study"] = tables.Starter(
    "identification.cli.starters",
    {"rig.yaml": "rig.yaml", "study.yaml": "study.yaml"},
    ("servotwin run rig.yaml --out recordings", "servotwin calibrate study.yaml --data recordings"),
)
tables.STARTERS["design"] = tables.Starter(
    "identification.cli.starters",
    {"rig.yaml": "rig.yaml", "study.yaml": "study.yaml", "design.yaml": "design.yaml"},
    ("servotwin design design.yaml --out next", "servotwin run next/experiments.yaml --out recordings"),
)
