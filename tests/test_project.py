"""Rules of the house that a reader relies on: who may import whom, what is pinned, what is documented."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import Counter, defaultdict
from importlib.metadata import version

import pytest
from ruamel.yaml import YAML

from fmus import library, models
from tests.benchmarks.__main__ import BENCH, ENDURANCE, module_of
from tests.support.imports import PACKAGES, ROOT, SOURCES, between_rooms, circles, imported, imports_of, needs

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BELOW = {"fmus": set(), "orchestrator": {"fmus"}, "identification": {"fmus", "orchestrator"}}
MOST = 15  # files of a folder besides its `__init__.py`: in a fuller one there is a second concept


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
    tree = ast.parse(
        "from . import ops\nfrom .model import Model\ndef f():\n    from ..units import parse\n    import a.b"
    )
    assert imported(tree, "fmus.packaging") == {
        "fmus.packaging.ops",
        "fmus.packaging.model.Model",
        "fmus.units.parse",
        "a.b",
    }


def test_a_circle_is_found_with_all_that_lies_on_it_and_nothing_else() -> None:
    graph = {"a": frozenset("b"), "b": frozenset("cd"), "c": frozenset("a"), "d": frozenset()}
    assert circles(graph) == {"a": ["b"], "b": ["c"], "c": ["a"]}


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_needs_only_those_below_it(package: str) -> None:
    """Neither at the top of a file nor in a function, nor in a program that it starts."""
    upward = {
        module: sorted(found)
        for module, needed in needs().items()
        if module.split(".")[0] == package and (found := tops(needed) - BELOW[package] - {package})
    }
    assert upward == {}


def test_no_circle_of_imports_between_files() -> None:
    assert circles(needs()) == {}


def test_no_circle_of_imports_between_rooms() -> None:
    assert circles(between_rooms(needs())) == {}


def test_no_folder_has_a_second_concept_in_it() -> None:
    files = [*SOURCES, *(ROOT / "tests").rglob("*.py")]
    counts = Counter(str(file.parent.relative_to(ROOT)) for file in files if file.name != "__init__.py")
    assert {folder: count for folder, count in counts.items() if count > MOST} == {}


def test_a_class_has_a_name_of_its_own() -> None:
    """One name, one thing: private ones too, in all three packages."""
    trees = (ast.parse(file.read_text(encoding="utf-8")) for file in SOURCES)
    counts = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, count in counts.items() if count > 1] == []


def test_no_function_gives_a_map_of_anything() -> None:
    """A document has a TypedDict beside what writes it; what is not ours to know is a `RawMap`."""
    bare = re.compile(r"\b(dict|Mapping)\[str, Any]")
    functions = (
        (str(file.relative_to(ROOT)), node)
        for file in SOURCES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and node.returns is not None
    )
    assert [(file, node.name) for file, node in functions if bare.search(ast.unparse(node.returns))] == []


@pytest.mark.parametrize("name", library.names())
def test_a_model_imports_only_the_language_and_the_standard_library(name: str) -> None:
    file = library.source_file(library.find(name))
    room = ".".join(file.parent.relative_to(ROOT).parts)
    assert {module for module in imports_of(file) if module.split(".")[0] not in sys.stdlib_module_names} <= {
        f"{room}.{name}" for name in models.__all__
    }


@pytest.mark.slow
def test_only_the_command_line_imports_its_library() -> None:
    assert [file for file in SOURCES if file.parent.name != "cli" and "typer" in tops(imports_of(file))] == []


def test_the_values_of_a_literal_stand_in_one_order() -> None:
    """`typing` takes two of the same values for one: what was loaded first would stand in schemas."""
    orders = defaultdict[frozenset[str], set[str]](set)
    for values in (found for file in SOURCES for found in re.findall(r"\bLiteral\[([^]]*)]", file.read_text())):
        orders[frozenset(re.split(r",\s*", values))].add(re.sub(r"\s+", " ", values))
    assert [found for found in orders.values() if len(found) > 1] == []


@pytest.mark.parametrize("name", [*BENCH, *ENDURANCE])
def test_every_bench_can_be_run(name: str) -> None:
    module = module_of(name)
    assert name not in BENCH or callable(module.figures)
    assert name not in ENDURANCE or callable(module.endurance)


def test_every_direct_dependency_is_pinned() -> None:
    assert [name for name in direct_dependencies() if name not in pins()] == []


def test_constraints_hold_exact_versions_and_nothing_of_one_machine() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line for line in lines if not line.startswith("#")]
    assert [line for line in pinned if not re.fullmatch(r"[\w.-]+==[\w.+!-]+", line)] == []


def test_the_hooks_before_a_commit_are_the_checks_of_make_lint() -> None:
    rule = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert rule is not None
    checks = {line.strip().removesuffix(" .").replace("$(BIN)", ".venv/bin") for line in rule[1].splitlines()}
    [repository] = YAML(typ="safe").load(ROOT / ".pre-commit-config.yaml")["repos"]
    assert {hook["entry"].replace(" --force-exclude", "") for hook in repository["hooks"]} == checks
    assert repository["repo"] == "local"


def test_the_changelog_begins_with_the_version_that_is_installed() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    latest = re.search(r"^## \[(\S+)\]", changelog, re.MULTILINE)
    assert latest is not None
    assert latest[1] == PROJECT["version"] == version("servotwin")
