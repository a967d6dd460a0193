"""Ports: where a model meets others by a flow and by what drives it, as at a shaft by torque and speed.

This file travels inside every Python FMU.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

KINDS = {
    "rotational": (("speed", "rad/s"), ("torque", "N.m")),
    "translational": (("speed", "m/s"), ("force", "N")),
    "electrical": (("voltage", "V"), ("current", "A")),
}
"""Kind -> its two quantities, the second a flow, with units of theirs."""


@dataclass(frozen=True)
class PhysicalPort:
    """Two variables of a model, an input and an output, whose product is the power that goes through.

    Attributes:
        kind: of `KINDS`.
        signal: variable that is equal on both sides, as the speed.
        flow: variable of what goes through, as the torque.
        outward: whether that counts from the model to what it meets, as the torque that a motor gives.
    """

    name: str
    kind: str
    signal: str
    flow: str
    outward: bool = False

    @property
    def members(self) -> Mapping[str, str]:
        """Quantity -> variable."""
        (signal, _), (flow, _) = KINDS[self.kind]
        return {signal: self.signal, flow: self.flow}


def port(name: str, kind: str, outward: bool = False, **variables: str) -> PhysicalPort:
    """A port: `port("shaft", "rotational", speed="speed", torque="torque")`."""
    wanted = [quantity for quantity, _ in KINDS.get(kind, ())]
    if sorted(variables) != sorted(wanted):
        known = f"{wanted[0]} and {wanted[1]}" if wanted else f"one of the kinds {', '.join(KINDS)}"
        raise ValueError(f"port '{name}' is {kind} and gives {', '.join(variables) or 'nothing'}; it needs {known}")
    signal, flow = (variables[quantity] for quantity in wanted)
    return PhysicalPort(name, kind, signal, flow, outward)


def problems(ports: tuple[PhysicalPort, ...], causalities: Mapping[str, str]) -> Iterator[str]:
    """What does not fit the variables of a model, name -> causality."""
    for one in ports:
        found = sorted(causalities.get(name, "nothing") for name in (one.signal, one.flow))
        if one.kind not in KINDS:
            yield f"port '{one.name}' is '{one.kind}', which is none of {', '.join(KINDS)}"
        elif found != ["input", "output"]:
            given = f"{one.signal} and {one.flow} are {' and '.join(found)}"
            yield f"port '{one.name}' needs an input and an output; {given}"
        if not one.name.isidentifier() or one.name in causalities or [x.name for x in ports].count(one.name) > 1:
            yield f"port '{one.name}' needs a name of its own, of letters, digits and underscores"
