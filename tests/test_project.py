"""Rules of the house that a reader relies on: who may import whom, what is pinned, what is documented."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from fmus import library, models

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGES = ("fmus", "orchestrator", "identification")
BELOW = {"fmus": set(), "orchestrator": {"fmus"}, "identification": {"fmus", "orchestrator"}}
COMMAND_LINE = sorted(file for package in PACKAGES for file in (ROOT / package / "cli").glob("*.py"))
SOURCES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))


def imported(tree: ast.AST, package: str) -> set[str]:
    """Modules that a file of this package imports, relative ones in full."""
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            modules |= {base} if node.module else {f"{base}.{alias.name}" for alias in node.names}
    return modules


def imports_of(file: Path) -> set[str]:
    package = ".".join(file.relative_to(ROOT).parent.parts)
    return imported(ast.parse(file.read_bytes()), package)


def tops(modules: set[str]) -> set[str]:
    return {module.split(".")[0] for module in modules}


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def direct_dependencies() -> list[str]:
    """Names, without version and extras, of what the project and its extras ask for."""
    asked = [*PROJECT["dependencies"], *(each for extra in PROJECT["optional-dependencies"].values() for each in extra)]
    return [normalised(re.match(r"[\w.-]+", each)[0]) for each in asked]  # type: ignore[index]


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {normalised(name): number for name, number in pairs}


def test_relative_imports_are_resolved_against_the_package() -> None:
    tree = ast.parse("from . import ops\nfrom .model import Model\nfrom ..instance import Instance\nimport a.b")
    assert imported(tree, "fmus.packaging") == {
        "fmus.packaging.ops",
        "fmus.packaging.model",
        "fmus.instance",
        "a.b",
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_those_below_it(package: str) -> None:
    upward = {
        str(file.relative_to(ROOT)): sorted(found)
        for file in SOURCES
        if file.is_relative_to(ROOT / package)
        and (found := tops(imports_of(file)) & set(PACKAGES) - BELOW[package] - {package})
    }
    assert upward == {}


@pytest.mark.parametrize("name", library.names())
def test_a_model_imports_only_ops_model_and_the_standard_library(name: str) -> None:
    modules = imports_of(ROOT / "fmus" / "models" / f"{name}.py")
    assert {module for module in modules if module.split(".")[0] not in sys.stdlib_module_names} <= {
        f"fmus.models.{name}" for name in models.__all__
    }


def test_only_the_command_line_imports_its_library() -> None:
    assert [file for file in SOURCES if file not in COMMAND_LINE and "typer" in tops(imports_of(file))] == []


def test_every_module_is_imported_without_a_cycle() -> None:
    names = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for file in SOURCES}
    reached: dict[str, set[str]] = {}
    for name, file in names.items():
        tree = ast.parse(file.read_bytes())
        body = ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], [])
        reached[name] = imported(body, name.rpartition(".")[0]) & set(names) - {name}
    for _ in names:
        without = {name for name, needed in reached.items() if not needed}
        reached = {name: needed - without for name, needed in reached.items() if name not in without}
    assert reached == {}


def test_every_direct_dependency_is_pinned() -> None:
    assert [name for name in direct_dependencies() if name not in pins()] == []


def test_constraints_hold_exact_versions_and_nothing_of_one_machine() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line for line in lines if not line.startswith("#")]
    assert [line for line in pinned if not re.fullmatch(r"[\w.-]+==[\w.+!-]+", line)] == []


def test_the_changelog_begins_with_the_version_that_is_installed() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    latest = re.search(r"^## \[(\S+)\]", changelog, re.MULTILINE)
    assert latest is not None
    assert latest[1] == PROJECT["version"] == version("servotwin")
