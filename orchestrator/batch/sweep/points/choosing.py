"""The factors of a study over all its systems, and the points that its design makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus.errors import ScenarioError, ServotwinError
from orchestrator.batch.sweep.points import designs, resolving
from orchestrator.batch.sweep.points.covariance import drawn_together
from orchestrator.batch.sweep.points.designs import PointDesign
from orchestrator.batch.sweep.points.factors import Factor, Law, Levels, Space, Target
from orchestrator.batch.sweep.points.listing import columns
from orchestrator.batch.sweep.points.resolving import FactorPlace
from orchestrator.batch.sweep.points.schema import (
    DrawnBlock,
    GridBlock,
    HypercubeBlock,
    ListBlock,
    MorrisBlock,
    SobolIndicesBlock,
    SweepBlock,
)
from orchestrator.settable import check_values


@dataclass(frozen=True)
class ChosenPoints:
    """What varies, and how its points are chosen."""

    space: Space
    design: PointDesign


def chosen(block: SweepBlock, places: Sequence[FactorPlace]) -> ChosenPoints:
    """The points of a study.

    Args:
        places: every system of it.

    Raises:
        ScenarioError: a factor is nothing that all systems have, is out of bounds, or does not fit the design.
    """
    if isinstance(block.design, ListBlock):
        return _listed(block.design, places)
    factors = [_one(name, [resolving.factor(name, one, place) for place in places]) for name, one in block.vary.items()]
    joint = None
    if block.calibration is not None:
        together, joint = drawn_together(block.calibration, places[0])
        if twice := sorted({one.name for one in together} & set(block.vary)):
            problem = "varies by itself and with the calibration"
            raise ScenarioError(f"{places[0].file}: vary.{twice[0]}", problem, "leave one out")
        factors += together
    space = Space(tuple(factors), joint)
    _check_bounds(space, places)
    return ChosenPoints(space, _design(block, space, places[0].file))


def _design(block: SweepBlock, space: Space, file: Path) -> PointDesign:
    asked = block.design
    if isinstance(asked, GridBlock):
        return designs.Grid(space)
    assert not isinstance(asked, ListBlock)
    if isinstance(asked, DrawnBlock):
        kind = designs.MonteCarlo if asked.by == "monte-carlo" else designs.SobolSequence
        return kind(space=space, count=asked.samples, seed=asked.seed)
    if isinstance(asked, HypercubeBlock):
        strata = asked.strata or asked.samples
        return designs.Hypercubes(space=space, count=asked.samples, seed=asked.seed, size=strata)
    if isinstance(asked, SobolIndicesBlock):
        if asked.samples & (asked.samples - 1):
            better = 1 << asked.samples.bit_length()
            raise ScenarioError(f"{file}: design.samples", f"{asked.samples} is no power of two", f"give {better}")
        count = asked.samples * designs.group_size(len(space), asked.second_order)
        return designs.SobolIndices(space=space, count=count, seed=asked.seed, second_order=asked.second_order)
    return _morris(asked, space, file)


def _morris(asked: MorrisBlock, space: Space, file: Path) -> PointDesign:
    unbounded = [one.name for one in space.alone if not one.law.bounded] + list(
        space.joint.names if space.joint else ()
    )
    if unbounded:
        problem = "has no ends, between which a trajectory could go"
        raise ScenarioError(f"{file}: vary.{unbounded[0]}", problem, "give it `between`, or take `sobol-indices`")
    count = asked.trajectories * (len(space) + 1)
    return designs.Morris(space=space, count=count, seed=asked.seed, levels=asked.levels)


def _listed(block: ListBlock, places: Sequence[FactorPlace]) -> ChosenPoints:
    factors = []
    for name, levels in columns(block, places[0].file).items():
        found = []
        for place in places:
            try:
                found.append(resolving.listed(name, levels, *place.target(name)))
            except ServotwinError as error:
                raise ScenarioError(f"{place.file}: design: {name}", error.problem, error.fix) from None
        factors.append(_one(name, found))
    space = Space(tuple(factors))
    _check_bounds(space, places)
    table = [one.law.levels for one in factors]
    return ChosenPoints(space, designs.Listed(np.stack(table, axis=1)))


def _one(name: str, found: Sequence[Factor]) -> Factor:
    """The factor, which is the same in every system."""
    if any(one != found[0] for one in found[1:]):
        raise ScenarioError(f"vary.{name}", "has another unit or type in another case", "sweep the cases one by one")
    return found[0]


def _check_bounds(space: Space, places: Sequence[FactorPlace]) -> None:
    """See that the ends of what has some lie within the bounds of the variables."""
    for factor in space.alone:
        if factor.target is not Target.VALUE:
            continue
        for place in places:
            for end in _ends(factor.law):
                try:
                    check_values(place.system, {factor.name: factor.value(end)})
                except ServotwinError as error:
                    raise ScenarioError(place.named(factor.name), error.problem, error.fix) from None


def _ends(law: Law) -> list[float]:
    """All levels of a law, or the ends of one that has some."""
    if isinstance(law, Levels):
        return list(law.values)
    ends: list[float] = law.at(np.array([0.0, 1.0])).tolist() if law.bounded else []
    return ends
