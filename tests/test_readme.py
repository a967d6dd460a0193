"""What README and docs say is so: their files, their tables, and every command, run in order in a copy of the tree."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.main import get_command

from fmus import errors, library
from fmus.packaging import targets
from identification.cli import app
from identification.study import load_study
from orchestrator.scenario.run import run_scenario
from tests.test_wire import assert_near_the_truth

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def contents(page: Path) -> list[Path]:
    """A page and, in order, those that it lists."""
    listed = re.search(
        r"^```\{toctree\}\n(?::.*\n)*\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    names = listed[1].split() if listed else []
    return [
        page,
        *(
            each
            for name in names
            if (page.parent / f"{name}.md").is_file()
            for each in contents(page.parent / f"{name}.md")
        ),
    ]


PAGES = [ROOT / "README.md", *contents(DOCS / "index.md")]
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
BLOCK = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_COPIED = (".venv", ".git", "out", "build", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis")


def blocks(*languages: str) -> list[str]:
    return [block["text"] for block in BLOCK.finditer(TEXT) if block["language"] in languages]


def files() -> dict[str, str]:
    """name -> text of the blocks whose first line is the name of a file."""
    named = [(re.match(r"# (\S+\.\w+)\n", text), text) for text in blocks("python", "yaml")]
    return {match[1]: text for match, text in named if match}


def commands(recordings: bool) -> list[str]:
    """Lines of the shell blocks; those that need the real recordings only when these are there."""
    lines = [line for text in blocks("sh") for line in text.splitlines() if line.strip()]
    return [line for line in lines if recordings or "$SERVOTWIN_DATA" not in line]


def recordings() -> Path | None:
    """Folder of the real recordings."""
    folder = Path(os.environ.get("SERVOTWIN_DATA", ROOT.parent / "shared" / "data"))
    return folder.resolve() if (folder / "butterfly").is_dir() else None


def documented(page: str, pattern: str) -> set[str]:
    """What the first cells of a page's tables hold in this form."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return set(re.findall(rf"^\| {pattern} \|", text, re.MULTILINE))


def command_names() -> set[str]:
    """All commands of the command line, subcommands in full."""
    names = set()
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        names |= {name} if inner is None else {f"{name} {part}" for part in inner}
    return names


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A folder with the files that the pages give."""
    for name, text in files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_the_model_file_builds_and_reaches_the_speed_it_says(written: Path) -> None:
    assert run_scenario(written / "flywheel.yaml").passed


def test_the_suppliers_fmu_takes_the_models_place(written: Path) -> None:
    targets.build(written / "flywheel.py", written / "out" / "fmus" / "flywheel.fmu", target="python")
    speed = run_scenario(written / "vendor.yaml").cases[0].result.trace["wheel.speed"][-1]  # type: ignore[union-attr]
    assert speed == pytest.approx(0.05 * 12 / (0.004 + 0.05**2), rel=1e-3)


def test_the_study_fits_its_schema(written: Path) -> None:
    study = load_study(written / "my_study.yaml")
    assert "154g_square" in study.block.traces.hold_out


def test_every_command_is_in_the_table() -> None:
    assert {
        name.strip() for name in documented("reference/commands.md", r"`servotwin ([a-z ]+)[^`|]*`.*")
    } == command_names()


def test_every_model_is_in_the_table() -> None:
    assert documented("guides/models.md", r"`(\w+)` \|.*") == set(library.names())


def test_the_errors_exit_codes_are_in_the_table() -> None:
    codes = {kind.exit_code for kind in vars(errors).values() if hasattr(kind, "exit_code")}
    assert {str(code) for code in codes | {0, 1, 130}} == documented("reference/commands.md", r"(\d+) \|.*")


def test_every_file_that_is_named_exists() -> None:
    named = re.findall(r"scenarios/\S+?\.yaml", TEXT)
    assert named
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_every_page_is_in_the_contents_and_every_link_leads_somewhere() -> None:
    assert set(DOCS.rglob("*.md")) - set(PAGES) == set()
    for page in PAGES:
        links = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
        assert [link for link in links if not (page.parent / link).exists()] == [], page


@pytest.mark.readme
@pytest.mark.timeout(0)
def test_every_command_works_in_the_order_given(tmp_path: Path) -> None:
    copy = tmp_path / "checkout"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
    for name, text in files().items():
        (copy / name).write_text(text, encoding="utf-8")
    data = recordings()
    script = "\n".join(["set -euxo pipefail", *commands(recordings=data is not None)])
    environment = {key: value for key, value in os.environ.items() if key not in ("VIRTUAL_ENV", "PYTHONPATH")}
    environment |= {"SERVOTWIN_DATA": str(data)} if data else {}
    done = subprocess.run(
        ["bash", "-c", script], cwd=copy, env=environment, capture_output=True, text=True, check=False
    )
    print(done.stdout, done.stderr, sep="\n")
    assert done.returncode == 0
    summary = json.loads((copy / "out" / "demo" / "bus" / "procedure" / "calibrated" / "summary.json").read_text())
    assert_near_the_truth(summary)
