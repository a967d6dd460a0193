"""What would tell parameters apart that recordings do not: by what they are of, which their units say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from fmus.units import BASES, parse
from identification.estimation.parameters import Parameter

Kind = Literal["inertia", "damping", "stiffness", "force", "gain", "time", "other"]

_MECHANICAL = {"inertia", "damping", "stiffness", "force"}
_BETWEEN: tuple[tuple[set[Kind], str], ...] = (
    ({"damping", "gain"}, "a current sensor, or a run down with the motor's circuit open"),
    ({"damping", "force"}, "speeds that differ more: a slower sweep beside a fast one"),
    ({"inertia", "stiffness"}, "an added mass"),
    ({"inertia", "damping"}, "a sweep through a resonance, or faster and slower motion"),
    ({"inertia", "force"}, "an added mass, or faster motion beside a slow one"),
    ({"stiffness", "force"}, "motion of other sizes: a large one beside a small one"),
)
_KNOWN_SIZE = "something of known size: an added mass, or a sensor of the force or the current"
_ANY = "a known value of one (`fixed`, or a `prior`), or a recording in which one acts alone"


def kind_of(unit: str) -> Kind:
    """What a quantity of this unit is of."""
    found = parse(unit)
    if found is None:
        return "other"
    power = dict(zip(BASES, found.exponents, strict=True))
    if power["A"]:
        return "gain"
    if power["kg"] == 1:
        rotary = power["m"] == 2
        elastic = (rotary and power["rad"] == -1) or (not rotary and power["m"] == 0)
        by_time: dict[int, Kind] = {0: "inertia", -1: "damping", -2: "stiffness" if elastic else "force"}
        return by_time.get(power["s"], "other")
    alone = {base for base, exponent in power.items() if exponent}
    return "time" if alone == {"s"} and power["s"] == 1 else "other"


def separating(parameters: Sequence[Parameter], only_ratios: bool) -> str:
    """What would tell these parameters apart, of which a combination is not seen.

    Args:
        only_ratios: whether all may grow by one factor.
    """
    kinds = [kind_of(parameter.unit) for parameter in parameters]
    if "time" in kinds:
        return "steps of the command, sampled faster"
    if only_ratios and len(kinds) > 1 and {*kinds} <= {*_MECHANICAL, "gain"} and {*kinds} != {"damping", "gain"}:
        return _KNOWN_SIZE
    for pair, remedy in _BETWEEN:
        if {*kinds} == pair:
            return remedy
    if {*kinds} == {"force"}:
        return "motion to both sides, and rest at several places"
    return _ANY
