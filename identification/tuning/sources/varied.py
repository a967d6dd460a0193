"""Plants that are one system with several values of one parameter, a payload say; and what lies between these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.linear.model import LinearModel
from identification.tuning.sources.plants import PlantSpec
from identification.tuning.sources.system_plant import SystemPlant
from orchestrator.trace import FloatArray

POINTS = 41


@dataclass(frozen=True, eq=False)
class Varied:
    """A system along one parameter.

    Attributes:
        name: component.variable.
        values: (K,) from the least to the largest of the plants', in its unit.
        models: the K linear models.
    """

    name: str
    values: FloatArray
    models: Sequence[LinearModel]


def varied(plants: Mapping[str, PlantSpec], step: float) -> Varied | None:
    """What lies between the plants, sampled every `step` [s]; None where they do not differ in one real parameter.

    Raises:
        InputError: as `SystemPlant.linear`.
    """
    systems = {f"plants.{name}": plant for name, plant in plants.items() if isinstance(plant, SystemPlant)}
    first = next(iter(systems.values()), None)
    if first is None or len(systems) < len(plants):
        return None
    if any(_built(plant) != _built(first) for plant in systems.values()):
        return None
    given = [plant.system.values() for plant in systems.values()]
    names = {name for values in given for name in values if len({repr(own.get(name)) for own in given}) > 1}
    if len(names) != 1:
        return None
    [name] = names
    ends = [plant.value(place, name) for place, plant in systems.items()]
    if None in ends:
        return None
    values = np.linspace(min(ends), max(ends), POINTS)  # type: ignore[type-var, arg-type]
    place = next(iter(systems))
    return Varied(name, values, first.along(place, step, name, values))


def _built(plant: SystemPlant) -> tuple[object, ...]:
    """Of what a plant is made, but for values."""
    components = {name: replace(component, parameters={}) for name, component in plant.system.components.items()}
    return components, plant.system.connections, dict(plant.inputs), dict(plant.outputs)
