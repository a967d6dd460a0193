"""The controller's FMU and that of a linear plant, run together as they run elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from fmus.models.plants.state_space import matrices, state_space
from identification.built_system import BuiltSystem
from identification.linear.model import LinearModel
from identification.tuning.study import CONTROLLER, PLANT, TuningStudy
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec
from orchestrator.engine import Timing
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class TuningBench:
    """Where they run.

    Attributes:
        controller: with the study's values.
        units: of the plants' inputs and outputs that have one.
        step: of the controller and the plants [s].
    """

    controller: ComponentSpec
    study: TuningStudy
    units: Mapping[str, str]
    step: Fraction

    def followed(self, plant: LinearModel, values: Mapping[str, float], height: float, samples: int) -> FloatArray:
        """(K,) what is tracked after a step of the reference, from rest.

        Args:
            values: of the controller's parameters over the study's.

        Raises:
            FmuError: an FMU fails.
        """
        controller = replace(self.controller, parameters={**self.controller.parameters, **values})
        spec = SystemSpec({CONTROLLER: controller, PLANT: self._plant(plant)}, self.study.connections)
        built = BuiltSystem(spec, [self.study.reference])
        timing = Timing(self.step * (samples - 1), self.step)
        with OpenSystem(built.assembled) as opened, opened.simulation(timing) as simulation:
            stimuli = {self.study.reference: np.full(len(simulation.instants()), height)}
            trace = simulation.run(built.assembled.system.values(), stimuli, [self.study.tracked]).trace
        return np.asarray(trace[self.study.tracked])

    def _plant(self, plant: LinearModel) -> ComponentSpec:
        ins, outs = ({name: self.units.get(name, "1") for name in names} for names in (plant.inputs, plant.outputs))
        values = matrices(plant.a, plant.b, plant.c) | {"sample_time": float(self.step)}
        return ComponentSpec(state_space(plant.order, ins, outs), values)
