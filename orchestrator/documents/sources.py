"""The document of a file, whatever it is written in: YAML, or a system as an SSP."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap, CommentedSeq

from fmus.files import RawMap
from orchestrator.documents import parsing
from orchestrator.ssp import is_ssp

LOG = logging.getLogger("servotwin.ssp")
EXTRA = "extra/servotwin"  # folder in an SSP of what a description of a system cannot say
SCENARIO = f"{EXTRA}/scenario.yaml"
_OF_THE_SYSTEM = ("fmu", "model", "parameters", "tables")


def parse(path: Path) -> tuple[CommentedMap, Path]:
    """The map that a file holds, and the folder that names of files in it are relative to.

    Raises:
        ScenarioError: no such file, no YAML, or YAML that no file of ours needs.
        FmuFileError, WiringError: an SSP that cannot be read, or does not fit together.
    """
    return _of_ssp(path) if is_ssp(path) else (parsing.parse(path), path.parent)


def plain(node: Any) -> Any:
    """The same in plain maps and lists."""
    if isinstance(node, Mapping):
        return {str(key): plain(value) for key, value in node.items()}
    return [plain(entry) for entry in node] if isinstance(node, list) else node


def _of_ssp(path: Path) -> tuple[CommentedMap, Path]:
    from orchestrator.ssp.annotations import whole  # noqa: PLC0415
    from orchestrator.ssp.document import imported  # noqa: PLC0415 (it brings FMPy along)
    from orchestrator.ssp.package import SYSTEM, SspPackage  # noqa: PLC0415

    found = imported(path)
    for note in found.notes:
        LOG.warning("%s: %s", path, note)
    with SspPackage(path) as package:
        extras = [name for name in package.names if name.startswith(f"{EXTRA}/")]
        files = {name: package.unpacked(name) for name in extras}
        found.document["ssp"] = str(package.kept(SYSTEM, whole(package)))
    if SCENARIO not in files:
        return _placed(found.document), path.parent
    scenario = plain(parsing.parse(files[SCENARIO]))
    return _placed(_over(found.document, scenario)), files[SCENARIO].parent


def _over(document: RawMap, scenario: RawMap) -> RawMap:
    """A system out of an SSP with what a scenario says besides; where both say something, the SSP counts."""
    made = {**document, **scenario}
    own = scenario.get("components", {})
    components = document["components"]
    for name, component in components.items():
        components[name] = {
            **{key: v for key, v in own.get(name, {}).items() if key not in _OF_THE_SYSTEM},
            **component,
        }
    made |= {"components": components, "connections": document["connections"], "ssp": document["ssp"]}
    made["run"] = {**document.get("run", {}), **scenario.get("run", {})}
    for key in ("start", "stop"):
        said, own_time = document.get("run", {}).get(key, "0"), scenario.get("run", {}).get(key, "0")
        if not _equal(said, own_time):
            made["run"][key] = said
    stimuli = _stimuli(document, scenario.get("stimuli", {}))
    made |= {"stimuli": stimuli} if stimuli else {}
    for name in stimuli:
        component, _, variable = name.partition(".")
        components.get(component, {}).get("parameters", {}).pop(variable, None)
    return made


def _stimuli(document: RawMap, given: RawMap) -> RawMap:
    """What drives inputs: constants by the SSP's word, recordings by the scenario's."""
    stimuli = {**document.get("stimuli", {}), **given}
    for name, block in document.get("stimuli", {}).items():
        constant = stimuli[name].get("constant")
        if isinstance(constant, int | float) and float(constant) != block["constant"]:
            stimuli[name] = block
    for name, block in given.items():
        component, _, variable = name.partition(".")
        value = document["components"].get(component, {}).get("parameters", {}).get(variable)
        if value is not None and isinstance(block.get("constant"), int | float) and float(block["constant"]) != value:
            stimuli[name] = {"constant": float(value)}
    return stimuli


def _equal(one: Any, other: Any) -> bool:
    from orchestrator.rational import seconds  # noqa: PLC0415 (only where a scenario lies in an SSP)

    return float(seconds(one)) == float(seconds(other))


def _placed(node: Any) -> Any:
    """The same as maps and lists that know lines, all of which are the first."""
    if isinstance(node, Mapping):
        made = CommentedMap((key, _placed(value)) for key, value in node.items())
        for key in made:
            made.lc.add_kv_line_col(key, [0, 0, 0, 0])
        return made
    if isinstance(node, list):
        entries = CommentedSeq(_placed(value) for value in node)
        for number in range(len(entries)):
            entries.lc.add_idx_line_col(number, [0, 0])
        return entries
    return node
