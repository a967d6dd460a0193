"""From what a study says of factors to laws in the units of the variables; each name is looked up in every system."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fmus.errors import ScenarioError, ServotwinError
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.batch.sweep.points.factors import Factor, Law, Levels, Target, TruncatedNormal, UniformBetween
from orchestrator.batch.sweep.points.schema import FactorBlock, Level, Number
from orchestrator.fmi.interface import Port, Written
from orchestrator.formats import read
from orchestrator.scenario.scenario import Scenario
from orchestrator.settable import settable
from orchestrator.system import Endpoint, System


@dataclass(frozen=True)
class FactorPlace:
    """Where factors are resolved: the study's folder, a scenario and its system.

    Attributes:
        file: the study.
    """

    file: Path
    scenario: Scenario
    system: System

    def named(self, name: str) -> str:
        return f"{self.file}: vary.{name}"

    def target(self, name: str, files: bool = False) -> tuple[Target, Port]:
        """What is varied by the name component.variable.

        Raises:
            ServotwinError: there is no such variable, or it cannot be varied.
        """
        if name in self.scenario.stimuli:
            return (Target.RECORDING if files else Target.CONSTANT), self.system.port(Endpoint.parse(name))
        return Target.VALUE, settable(self.system, name).port


def factor(name: str, block: FactorBlock, place: FactorPlace) -> Factor:
    """What varies by this name.

    Raises:
        ScenarioError: it is nothing that can be varied so; the message names the study and the key.
    """
    try:
        if block.files is not None and "." not in name:
            return Factor(name, _numbers(block.files), Target.FMU, words=tuple(map(str, block.files)))
        target, port = place.target(name, block.files is not None)
        if block.files is not None:
            if target is not Target.RECORDING:
                raise ScenarioError(name, "is driven by no stimulus", "give `levels`, or a stimulus in the scenario")
            return Factor(name, _numbers(block.files), target, port.unit or "", tuple(map(str, block.files)))
        if block.levels is not None:
            return listed(name, block.levels, target, port)
        if not port.real:
            raise ScenarioError(name, f"is of type {port.type}", "give its values as `levels`")
        return Factor(name, _law(name, block, port), target, port.unit or "")
    except ServotwinError as error:
        raise ScenarioError(place.named(name), _told(name, error), error.fix) from None


def listed(name: str, levels: Sequence[Level], target: Target, port: Port) -> Factor:
    """A factor with these values, in the order in which they are given.

    Raises:
        FmuFileError, WiringError: one is no value of the variable.
    """
    given = [port.typed(name, Written(level) if isinstance(level, str) and port.type != "String" else level)
             for level in levels]  # fmt: skip
    unit = port.unit or ""
    if port.items or port.type == "String":
        return Factor(name, _numbers(levels), target, unit, tuple(map(str, levels)))
    law = Levels(tuple(float(value) for value in given))
    kind = bool if port.type == "Boolean" else None if port.real else int
    return Factor(name, law, target, unit, whole=kind)


def stimuli(block: FactorBlock, place: FactorPlace, name: str) -> tuple[Stimulus, ...]:
    """What drives an input at each level, in its unit.

    Raises:
        TraceError: a recording cannot be read.
    """
    found, port = [], place.system.port(Endpoint.parse(name))
    for file in block.files or ():
        trace = read(place.file.parent / file).trace
        if block.signal is None and len(trace.names) > 1:
            raise ScenarioError(place.named(name), f"{file} has {len(trace.names)} signals", "name one by `signal`")
        one = trace.select([block.signal or trace.names[0]])
        found.append(Stimulus(one, None, file=place.file.parent / file).brought(name, port)[0])
    return tuple(found)


def _numbers(of: Sequence[object]) -> Levels:
    return Levels(tuple(map(float, range(len(of)))))


def _law(name: str, block: FactorBlock, port: Port) -> Law:
    ends = None if block.between is None else [port.number(name, end) for end in block.between]
    if ends is not None and not ends[0] < ends[1]:
        raise ScenarioError(name, f"`between` {ends[0]:g} and {ends[1]:g} is no interval", "give the lower end first")
    if block.normal is not None and block.std is not None:
        mean, std = port.number(name, block.normal), _spread(name, block.std, port)
        return _normal(name, mean, std, ends or [-math.inf, math.inf])
    assert ends is not None
    if block.scale == "log" and ends[0] <= 0:
        raise ScenarioError(name, f"has no logarithm at {ends[0]:g}", "begin above 0, or leave `scale` out")
    return UniformBetween(ends[0], ends[1], block.scale == "log", block.count or 2)


def _normal(name: str, mean: float, std: float, ends: Sequence[float]) -> TruncatedNormal:
    if not std > 0:
        raise ScenarioError(name, f"has a standard deviation of {std:g}", "give more than 0")
    if (ends[0] - mean) / std > 8 or (mean - ends[1]) / std > 8:
        raise ScenarioError(name, "hardly ever lies in `between`", "correct `normal`, `std` or `between`")
    return TruncatedNormal(mean, std, ends[0], ends[1])


def _spread(name: str, std: Number, port: Port) -> float:
    return port.quantity(name, std, difference=True) if isinstance(std, str) else std


def _told(name: str, error: ServotwinError) -> str:
    """A problem without the name of the factor, which the place has."""
    return error.problem if error.place == name else f"{error.place} {error.problem}"
