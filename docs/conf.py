"""The site of these pages: `make docs`; a warning is an error there."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from typer.main import get_command

from identification.cli import app

HERE = Path(__file__).parent
project = "servotwin"
release = version = version_of("servotwin")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]  # a fragment of YAML with braces is no whole document
# Notebooks are run anew with each build; one that fails is an error.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
os.environ["PLOTLY_RENDERER"] = "notebook"  # figures that a page shows without a network
html_theme = "pydata_sphinx_theme"
html_title = "servotwin"
html_theme_options = {"show_toc_level": 2, "navigation_with_keys": True}
html_show_sourcelink = False
autodoc_default_options = {"members": True, "member-order": "groupwise"}
autodoc_typehints = "description"
napoleon_google_docstring = True


def _said(command: list[str]) -> str:
    words = [sys.executable, "-c", "from identification.cli import main; main()", *command, "--help"]
    environment = {"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1", "PATH": ""}
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=HERE.parent, env=environment).stdout


def _options_page() -> str:
    """What `--help` of each command says."""
    names: list[list[str]] = []
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        names += [[name, part] for part in getattr(command, "commands", {})] or [[name]]
    parts = [f"## servotwin {' '.join(name)}\n\n```text\n{_said(name).strip()}\n```\n" for name in sorted(names)]
    return "\n".join(["# Options of the commands\n", *parts])


(HERE / "reference" / "options.md").write_text(_options_page(), encoding="utf-8")
