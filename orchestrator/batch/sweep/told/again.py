"""One run of a sweep again, as a scenario by itself: with its whole record, and a report of its own."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

from fmus.errors import InputError
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.batch.sweep.points.designs import seed_of
from orchestrator.batch.sweep.points.factors import Target
from orchestrator.batch.sweep.runs.preparation import PreparedSweep
from orchestrator.scenario.scenario import Scenario
from orchestrator.trace import FloatArray


def command(study: Path, run: int) -> str:
    """What runs it again."""
    return f"servotwin sweep {shlex.quote(str(study))} --run {run}"


def alone(study: PreparedSweep, run: int) -> Scenario:
    """The scenario of a run, in the units of its system.

    Raises:
        InputError: the study has no such run.
    """
    if not 0 <= run < study.runs:
        raise InputError(f"--run {run}", "is no run of the study", f"give one from 0 to {study.runs - 1}")
    setup = study.setup
    number, which = divmod(run, len(setup.cases))
    point = study.design.points(number, number + 1)[0]
    place, of_variant = setup.place(point, which)
    scenario, case = setup.variants[place].scenario, setup.variants[place].scenario.cases[of_variant]
    pairs = zip(setup.space.factors, point, strict=True)
    given = {one.name: one.value(x) for one, x in pairs if one.target is Target.VALUE}
    seeds = {f"{name}.seed": seed_of(setup.seed, number, part) for part, name in enumerate(setup.noise)}
    expected = case.expected[: len(case.expected) - len(study.block.measures)]
    one = replace(case, name=f"run {run}, {case.name}", values={**case.values, **given, **seeds}, expected=expected)
    recorded = scenario.record
    if recorded is not None:
        looked_at = [signal for wanted in case.expected for signal in wanted.signals]
        kept = setup.kept.signals if setup.kept else ()
        recorded = tuple(dict.fromkeys([*recorded, *looked_at, *kept]))
    stimuli = {**scenario.stimuli, **_stimuli(study, point)}
    return replace(scenario, cases=(one,), stimuli=stimuli, record=recorded)


def _stimuli(study: PreparedSweep, point: FloatArray) -> dict[str, Stimulus]:
    """What drives inputs otherwise than the scenario says."""
    found = {}
    for place, factor in enumerate(study.setup.space.factors):
        if factor.target is Target.CONSTANT:
            found[factor.name] = Stimulus(float(point[place]))
        elif factor.target is Target.RECORDING:
            found[factor.name] = study.setup.recordings[place][int(point[place])]
    return found
