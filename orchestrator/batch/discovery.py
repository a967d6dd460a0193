"""What the regression suite consists of: the files under some paths, who judges each, and where its results go."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fmus.errors import ScenarioError
from orchestrator.batch.procedure import run_procedure
from orchestrator.batch.scenario_judge import ScenarioJudge
from orchestrator.batch.verdict import FileJudge
from orchestrator.documents.parts import INCLUDE, PART
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import keys, load_joined

_KEY = re.compile(r"^(\w+) ?:", re.MULTILINE)


@dataclass(frozen=True)
class SuiteFile:
    """A file of the suite, who judges it, and its results: two levels below the folder for all of them."""

    file: Path
    judge: FileJudge
    place: Path


def find_scenarios(
    paths: Sequence[Path], judges: Mapping[str, FileJudge], run: FileJudge | None = None
) -> list[SuiteFile]:
    """The files to be judged among and under these paths: YAML files with `run`, `procedure` or a key of `judges`, but
    those with a `can` block only where they are named. A file that cannot be read is among them, too, and will fail.

    Args:
        judges: key at the top of a file that is neither a scenario nor a procedure -> who judges it.
        run: who judges scenarios.

    Raises:
        ScenarioError: a path is not there, a file given by name is no such file, there is none at all, or two have
            one folder for their results.
    """
    known: dict[str, FileJudge] = {"run": run or ScenarioJudge(), "procedure": run_procedure, **judges}
    found: dict[Path, SuiteFile] = {}
    for path in paths:
        if path.is_file():
            judge = _judge(keys(path), known, named=True)
            if judge is None:
                load_joined(path, ScenarioBlock)  # says what is missing
            found[path] = SuiteFile(path, judge or known["run"], Path(path.resolve().parent.name, path.stem))
        elif path.is_dir():
            found |= {task.file: task for task in _tasks(path, known)}
        else:
            raise ScenarioError(path, "no such file or folder", "check the path")
    if not found:
        raise ScenarioError(", ".join(map(str, paths)), "there is no scenario", "give a folder that holds some")
    _refuse_shared_places(found.values())
    return list(found.values())


def _tasks(folder: Path, known: Mapping[str, FileJudge]) -> Iterator[SuiteFile]:
    """Those of a folder."""
    for file in sorted(folder.rglob("*.yaml")):
        try:
            judge = _judge(_top_keys(file), known)
        except ScenarioError:
            judge = known["run"]  # it will say what is wrong with the file
        if judge is not None:
            inside = file.relative_to(folder).parent
            group = ".".join(inside.parts) or folder.resolve().name
            yield SuiteFile(file, judge, Path(group, file.stem))


def _top_keys(file: Path) -> Sequence[str]:
    """The keys at the top of a file, joined with the parts that it includes.

    To parse all files of a suite would keep those waiting that run them; a line that begins with a word and a colon is
    a key at the top of YAML as people write it, and what has none that tells what it is, or includes parts, is parsed.
    """
    try:
        found = _KEY.findall(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        found = []
    sure = {PART, "run", "procedure", "method"} & set(found) and INCLUDE not in found
    return found if sure else keys(file)


def _judge(found: Sequence[str], known: Mapping[str, FileJudge], named: bool = False) -> FileJudge | None:
    """Who judges a file with these keys; nobody where it is not for the suite: a part of scenarios, and where it is not
    named, one side of a bus."""
    if PART in found or ("can" in found and not named):
        return None
    return next((known[key] for key in found if key in known), None)


def _refuse_shared_places(tasks: Iterable[SuiteFile]) -> None:
    """See that no two files would write one folder, also where upper and lower case are one."""
    taken: dict[str, Path] = {}
    for task in tasks:
        place = str(task.place).casefold()
        if place in taken:
            raise ScenarioError(
                task.file,
                f"would write its results to {task.place}, and so would {taken[place]}",
                "rename one, or test the folder that holds both",
            )
        taken[place] = task.file
