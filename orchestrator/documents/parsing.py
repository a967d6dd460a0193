"""YAML files as maps that know the line of each key; what could harm, or means something unexpected, is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent, ScalarEvent
from ruamel.yaml.parser import Parser
from ruamel.yaml.scanner import Scanner

from fmus.errors import ScenarioError
from fmus.files import absence

LARGEST = 4 << 20
LONGEST_NUMBER = 100  # digits
DEEPEST = 50  # lists and maps inside each other
_LONG_NUMBER = re.compile(r"[-+]?0?[xob]?[0-9a-fA-F_]+")
_DATE = re.compile(r"\d{4}-\d\d?-\d\d?")


def parse(path: Path) -> CommentedMap:
    """The map that a file holds.

    Raises:
        ScenarioError: no such file, no YAML, or YAML that no file of ours needs.
    """
    if not path.is_file():
        raise ScenarioError(path, absence(path), "check the path")
    if path.stat().st_size > LARGEST:
        raise ScenarioError(path, "is larger than 4 MiB", "move data into a trace file")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        fix = "`servotwin info` tells what it is" if path.suffix not in (".yaml", ".yml") else "save it as UTF-8 text"
        raise ScenarioError(path, f"cannot be read ({error})", fix) from error
    try:
        yaml = YAML(pure=True)  # libyaml is faster, but does not keep the line of each key
        yaml.Parser, yaml.Scanner = _CarefulParser, Scanner  # not those that keep comments, which nobody reads here
        document = yaml.load(text)
    except ScenarioError as error:
        raise ScenarioError(f"{path}{error.place}", error.problem, error.fix) from None
    except Exception as error:  # besides its own, the parser lets errors of int, datetime and the stack through
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or str(error) or type(error).__name__
        raise ScenarioError(place, f"is not YAML ({one_line(problem)})", "mend the line") from error
    if not isinstance(document, CommentedMap):
        raise ScenarioError(path, "holds no keys", "start with `title:`")
    return document


class _CarefulParser(Parser):
    """Refuses on the way what `_refuse_exotic` does; places lack the file."""

    depth = 0

    def get_event(self) -> Any:
        event = super().get_event()
        self.depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        _refuse_exotic(event, self.depth)
        return event


def _refuse_exotic(event: Any, depth: int) -> None:
    """Aliases and nesting can make a small file a long job, and tags name types that a scenario has no use for."""
    place = f":{event.start_mark.line + 1}"
    if depth > DEEPEST:
        raise ScenarioError(place, f"is nested more than {DEEPEST} levels deep", "flatten it")
    if isinstance(event, AliasEvent):
        raise ScenarioError(place, "uses a YAML alias (*name)", "write the values out")
    tag = getattr(event, "tag", None) if isinstance(event, NodeEvent) else None
    if tag is not None:
        raise ScenarioError(place, f"uses the YAML tag {one_line(tag)}", "leave the tag out")
    if not isinstance(event, ScalarEvent) or event.style is not None:
        return
    if len(event.value) > LONGEST_NUMBER and _LONG_NUMBER.fullmatch(event.value):
        raise ScenarioError(place, f"holds a number of {len(event.value)} digits", "write a smaller one")
    if _DATE.match(event.value):
        raise ScenarioError(place, f"holds the date {one_line(event.value)}", "put it in quotes")


def one_line(text: object) -> str:
    """Text from a file, fit for a message."""
    return " ".join(str(text).split())[:200]
