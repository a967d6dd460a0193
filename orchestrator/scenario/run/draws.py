"""Runs of a case that differ from it by their noise alone, for expectations that are judged by what noise allows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from fmus.errors import ScenarioError
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.scenario.scenario import Case
from orchestrator.trace import Trace

APART = 1_000_003  # from the seeds of one draw to those of the next; cases are 1000 apart


def drawn(simulation: Simulation, run: Run, case: Case) -> dict[tuple[str, ...], list[Trace]]:
    """Traces of the signals that the case wants to see with other noise, by the components whose seeds vary.

    Raises:
        ScenarioError: one of them has no seed, or none has.
        RunFailed: an FMU failed in one.
    """
    found = {}
    for vary in dict.fromkeys(draws.vary for _, draws in case.drawn):
        wanted = [(signal, draws.count) for signal, draws in case.drawn if draws.vary == vary]
        seeds = _seeds(case, run.values, vary)
        record = tuple(dict.fromkeys(signal for signal, _ in wanted))
        found[vary] = [
            simulation.execute(replace(run, values={**run.values, **_moved(seeds, number)}, record=record)).trace
            for number in range(1, max(count for _, count in wanted) + 1)
        ]
    return found


def _seeds(case: Case, values: Mapping[str, Value], vary: Sequence[str]) -> dict[str, int]:
    """The seeds of these components, of all where none is named."""
    known = {name.removesuffix(".seed"): value for name, value in values.items() if name.endswith(".seed")}
    seeds = {name: int(value) for name, value in known.items() if isinstance(value, int | float)}
    missing = [name for name in vary if name not in seeds]
    if not seeds or missing:
        whose = missing[0] if missing else "no component"
        problem = f"has no noise to draw again: {whose} is given {'no' if missing else 'a'} `seed`"
        fix = f"known are {', '.join(seeds)}" if seeds else "give the components that make noise one"
        raise ScenarioError(f"case {case.name}", problem, fix)
    return {f"{name}.seed": seeds[name] for name in vary or seeds}


def _moved(seeds: Mapping[str, int], number: int) -> dict[str, Value]:
    return {name: seed + APART * number for name, seed in seeds.items()}
