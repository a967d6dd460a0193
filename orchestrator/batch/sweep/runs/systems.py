"""The systems of a sweep, built and wired: one for each choice of FMUs and each system that the cases have."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.errors import ScenarioError
from fmus.words import nearest
from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.batch.sweep.points.schema import SweepBlock
from orchestrator.crossing import logged
from orchestrator.scenario.expectations import Expected
from orchestrator.scenario.expectations.on_run import OnRun
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import check_values, typed
from orchestrator.system import System
from orchestrator.yaml_file import naming

OF_THE_MACHINE = ("processor_time", "real_time_factor", "frames_lost", "late_steps")
"""Kinds of expectations that are no matter of the point, and come out otherwise from run to run: not judged."""


@dataclass(frozen=True)
class Wired:
    """A system with its cases.

    Attributes:
        scenario: with these cases alone, whose expectations end with the study's measures, in the units of the system.
        cases: their numbers among those of the sweep.
        measures: names of the measures, whose expectations come last in each case.
        left_out: what is asked of cases, and not judged.
    """

    assembled: Assembled
    system: System
    scenario: Scenario
    cases: tuple[int, ...]
    measures: tuple[str, ...]
    left_out: tuple[str, ...]


def choices(block: SweepBlock, base: Path) -> list[dict[str, Path]]:
    """Component -> FMU file, for all combinations of FMUs; the last component changes fastest."""
    files = {name: one.files for name, one in block.vary.items() if one.files is not None and "." not in name}
    return [
        {name: base / file for name, file in zip(files, combined, strict=True)}
        for combined in itertools.product(*files.values())
    ]


def wired(block: SweepBlock, file: Path, folder: Path) -> list[Wired]:
    """All systems, in the order in which `Setup.place` finds them; FMUs are built into the folder.

    Raises:
        ScenarioError: there is no such case.
        ServotwinError: what loading, building and wiring the scenario raises.
    """
    found: list[Wired] = []
    for fmus in choices(block, file.parent):
        scenario = _with_cases(load_scenario(file.parent / block.sweep, fmus=fmus), block, file)
        first = 0
        for part in scenario.by_system():
            numbers = tuple(range(first, first + len(part.cases)))
            found.append(_wired(part, numbers, block, file, folder / str(len(found))))
            first += len(part.cases)
    return found


def _with_cases(scenario: Scenario, block: SweepBlock, file: Path) -> Scenario:
    """The scenario with the cases that are wanted, in the order of the study."""
    known = {case.name: case for case in scenario.cases}
    for name in block.cases or ():
        if name not in known:
            raise ScenarioError(f"{file}: cases", f"there is no case '{name}'", nearest(name, known))
    wanted = dict.fromkeys(block.cases or known)
    return replace(scenario, cases=tuple(known[name] for name in wanted))


def _wired(scenario: Scenario, numbers: tuple[int, ...], block: SweepBlock, file: Path, folder: Path) -> Wired:
    named = dict(_measures(block, file))
    left_out = tuple(
        dict.fromkeys(str(one) for case in scenario.cases for one in case.expected if _is_no_matter_of_points(one))
    )
    cases = tuple(
        replace(case, expected=(*(one for one in case.expected if not _is_no_matter_of_points(one)), *named.values()))
        for case in scenario.cases
    )
    assembled = assemble(scenario.system, folder, scenario.driven)
    with OpenSystem(assembled) as opened:
        with scenario.naming():
            own, crossed = in_units_of(opened.system, replace(scenario, cases=cases))
            logged([*opened.system.crossings, *crossed])
            own = replace(own, cases=tuple(_typed(case, opened.system) for case in own.cases))
            for case in own.cases:
                fixed = {name: value for name, value in case.values.items() if name not in block.vary}
                check_values(opened.system, {} if case.may_be_refused else fixed)
        return Wired(assembled, opened.system, own, numbers, tuple(named), left_out)


def _typed(case: Case, system: System) -> Case:
    """The case with its values as numbers in the units of their variables."""
    return replace(case, values=typed(system, case.values))


def _measures(block: SweepBlock, file: Path) -> Iterator[tuple[str, Expected]]:
    """Name and expectation of each measure."""
    with naming(file):
        for name, asked in block.measures.items():
            if asked.of_a_case:
                raise ScenarioError(f"measures.{name}", "has a reference of a case", "name the file of the reference")
            yield name, asked.expectation(file.parent)


def _is_no_matter_of_points(expected: Expected) -> bool:
    """Whether it is asked of the machine, or was accepted of the scenario's own values."""
    return expected.accepted or any(isinstance(leaf, OnRun) and leaf.kind in OF_THE_MACHINE for leaf in expected.leaves)
