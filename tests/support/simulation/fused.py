"""Systems as one FMU beside the same systems wired: scenarios, and their rows from either."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fmus.packaging import targets
from orchestrator.assembly.assembly import OpenSystem, assemble
from orchestrator.fmi.interface import Value
from orchestrator.scenario.fusing import build, fuse
from orchestrator.scenario.schema import load_scenario
from orchestrator.settable import typed
from orchestrator.system import Endpoint
from orchestrator.trace import FloatArray
from tests.support.fmus.either import opened

METER = """
from . import Model, State, input_, ops, output, parameter

def outputs(t, x, u, p):
    return {"twice": 2.0 * u.angle + t, "warm": u.warmth - p.zero}

def update(t, x, u, p):
    return {"seen": ops.where(u.angle > p.zero, x.seen + u.angle, x.seen - 1.0)}

MODEL = Model(
    name="meter",
    description="Shows degrees",
    variables=(
        input_("angle", "deg", "Angle"),
        input_("warmth", "degC", "Temperature", 20.0),
        output("twice", "deg", "Twice the angle"),
        output("warm", "degC", "Above zero"),
        output("seen", "1", "Sum of what was seen"),
        parameter("zero", "1", 0.5, "Where the scale begins"),
        parameter("sample_time", "s", 0.006, "Sample period", minimum=1e-6),
    ),
    states=(State("seen", sampled=True),),
    update=update,
    outputs=outputs,
    sample_time="sample_time",
)
"""
# Steps of different length, slow dynamics between fast control, wires with units, factors and offsets, an array, a
# model twice, one of the user's own, and an input that is driven from outside.
MANY_RATES = """
title: Everything that wires and rates can be
components:
  source: {model: excitation, step: 0.004, parameters: {shape: sine, amplitude: 0.8, frequency: 1.5}}
  controller: {model: pd, step: 0.002, parameters: {kp: 1.5, kd: 0.1, sample_time: 0.004}}
  filter:
    model: state_space
    step: 0.006
    parameters: {A: [[0.9, 0.05], [-0.1, 0.8]], B: [[0.1], [0.2]], C: [[1, 0.5]], x_start: [0.3, -0.2],
      sample_time: 0.006}
  drive: {model: servo_drive, step: 0.002}
  hand: {model: pendulum, step: 0.003, parameters: {angle_start: 0.4, coulomb_friction_positive: 0.002}}
  other: {model: pendulum, step: 0.012, parameters: {angle_start: 12 deg}}
  meter: {model: meter.py, step: 0.003}
connections:
  - source.signal -> controller.reference
  - 1.25 * hand.angle + 0.05 -> controller.position
  - -0.5 * hand.speed -> controller.speed
  - controller.voltage -> drive.voltage
  - hand.angle -> filter.u
  - hand.angle -> meter.angle
  - 0.1 * drive.torque - 0.01 -> hand.torque
  - 0.01 * filter.y -> other.torque
stimuli: {meter.warmth: {constant: 300 K}}
run: {stop: 1.2, step: 0.002}
"""


def many_rates(folder: Path, *changes: tuple[str, str]) -> Path:
    """A scenario with its model file, some of its text replaced."""
    text = MANY_RATES
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "meter.py").write_text(METER)
    (folder / "many rates.yaml").write_text(text)
    return folder / "many rates.yaml"


def of_fmus(folder: Path, fmi: int, *models: str) -> list[tuple[str, str]]:
    """Changes of that scenario with which components of these models are FMUs, as if another tool had made them."""
    for model in models:
        targets.build(model, folder / f"{model}.fmu", target="native", fmi=fmi)
    return [(f"model: {model},", f"fmu: {model}.fmu,") for model in models]


def fused(
    file: Path, folder: Path, fmi: int = 2, expose: Sequence[str] = (), platforms: Sequence[str] = ("host",)
) -> Path:
    """The FMU of a scenario's system; with no platform only what it is built from."""
    return build(fuse(file, expose), folder, fmi, platforms)


@dataclass(frozen=True)
class Wired:
    """What a wired system gives at every step of its run: its outputs, what drove its inputs, and what was set."""

    time: FloatArray
    outputs: Mapping[str, FloatArray]
    inputs: Mapping[str, FloatArray]
    values: Mapping[str, Value]


def wired(file: Path, seconds: float) -> Wired:
    """The first `seconds` of a scenario's first case, as `servotwin run` steps it."""
    scenario, names = load_scenario(file, references=False), fuse(file).system.outputs
    timing = replace(scenario.timing, stop=scenario.timing.start + Fraction(str(seconds)))
    with (
        TemporaryDirectory() as folder,
        OpenSystem(assemble(scenario.system, Path(folder), scenario.driven)) as system,
        system.simulation(timing) as simulation,
    ):
        case = typed(system.system, scenario.cases[0].values)
        inputs = {}
        for name, stimulus in scenario.stimuli.items():
            brought, _ = stimulus.brought(name, system.system.port(Endpoint.parse(name)))
            inputs[name] = brought.values(simulation.instants(), name)
        trace = simulation.run({**system.assembled.system.values(), **case}, inputs, names).trace
    return Wired(trace.time, {name: trace[name] for name in names}, inputs, case)


def stepped(path: Path, like: Wired, every: int = 1) -> FloatArray:
    """(K, m) what an FMU alone gives in FMPy, with the inputs of a wired system; `every` of its steps at once."""
    numbers = {name: value for name, value in like.values.items() if not isinstance(value, str)}
    with opened(path) as fmu:
        first = {name: float(values[0]) for name, values in like.inputs.items()}
        settable = {name for name, variable in fmu.variables.items() if variable.causality != "output"}
        known = {k: value for k, value in numbers.items() if {k, k.partition("[")[0]} & settable}
        fmu.start(float(like.time[0]), **known, **first)
        rows = [fmu.get(*like.outputs)]
        for k in range(0, len(like.time) - every, every):
            for name, values in like.inputs.items():
                fmu.set(name, float(values[k]))
            fmu.step(float(like.time[k]), float(like.time[k + every] - like.time[k]))
            rows.append(fmu.get(*like.outputs))
    return np.array(rows)
