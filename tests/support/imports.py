"""Which of the project's modules need which: imports at the top, within functions, and in programs given as text."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("fmus", "orchestrator", "identification")
SOURCES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
Graph = Mapping[str, frozenset[str]]


def name_of(file: Path) -> str:
    """Dotted name of a module; that of a package for its `__init__.py`."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {
    name_of(file): file
    for package in PACKAGES
    for file in (ROOT / package).rglob("*.py*")
    if file.suffix in (".py", ".pyi")
}


def imported(tree: ast.AST, package: str) -> set[str]:
    """Dotted names that a file of this package imports, with what it takes from them: `from a import b` gives `a.b`."""
    return set(_imported(ast.walk(tree), package))


def _imported(nodes: Iterable[ast.AST], package: str) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def imports_of(file: Path) -> set[str]:
    """Dotted names that a file imports, anywhere in it."""
    return imported(ast.parse(file.read_bytes()), _package(file))


def _package(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).parent.parts)


@cache
def needs() -> Graph:
    """module -> other modules of the project that it imports or names in a text; not those only its annotations need.

    What stands below `if TYPE_CHECKING` is never imported: it makes no circle when the program runs.
    """
    return {name: frozenset(_needed(name, file)) for name, file in MODULES.items()}


def _needed(name: str, file: Path) -> set[str]:
    nodes = [*_running(ast.parse(file.read_bytes()))]
    found = {module for target in _imported(nodes, _package(file)) if (module := _module(target))}
    return (found | _named_in_texts(nodes)) - {name}


def _module(target: str) -> str | None:
    """The module of the project that a dotted name is, or is in."""
    while target and target not in MODULES:
        target = target.rpartition(".")[0]
    return target or None


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those that never run: blocks for the type checker, and docstrings."""
    ahead = [tree]
    while ahead:
        yield (node := ahead.pop())
        ahead += [part for part in ast.iter_child_nodes(node) if not _idle(part)]


def _idle(node: ast.AST) -> bool:
    if isinstance(node, ast.If):
        return "TYPE_CHECKING" in ast.unparse(node.test)
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _named_in_texts(nodes: Iterable[ast.AST]) -> set[str]:
    """Modules that are named in full in strings: tables of what is loaded later, programs of child processes."""
    texts = [node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    words = {word for text in texts for word in re.findall(r"(?<![\w./])\w+(?:\.\w+)+", text)}
    return words & set(MODULES)


def room_of(module: str) -> str:
    """The folder of a module; the module itself where it lies beside rooms, as `orchestrator/trace.py` does."""
    folder = MODULES[module].parent
    beside_rooms = any(folder.glob("*/__init__.py"))
    return module if beside_rooms else ".".join(folder.relative_to(ROOT).parts)


def between_rooms(graph: Graph) -> Graph:
    """room -> other rooms that its files need."""
    rooms: dict[str, set[str]] = {}
    for module, needed in graph.items():
        room = room_of(module)
        rooms.setdefault(room, set()).update({room_of(other) for other in needed} - {room})
    return {room: frozenset(needed) for room, needed in rooms.items()}


def circles(graph: Graph) -> dict[str, list[str]]:
    """node -> what it needs, of all nodes on a circle; empty where there is none."""
    reach = {node: _reached(graph, node) for node in graph}
    bound = {node for node in graph if node in reach[node]}
    return {node: sorted(other for other in graph[node] & bound if node in reach[other]) for node in sorted(bound)}


def _reached(graph: Graph, start: str) -> set[str]:
    found: set[str] = set()
    ahead = list(graph[start])
    while ahead:
        node = ahead.pop()
        if node not in found:
            found.add(node)
            ahead += graph.get(node, ())
    return found
