"""A controller of any FMU, made linear by the pulses that it answers with: exact for one that is linear where it rests.

Each input is given one sample beside its start value; the answers (Markov parameters) are realised by a Hankel matrix
(Ho and Kalman 1966). A run under random inputs then has to be the realisation's, so that nothing nonlinear passes.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from fmus.errors import IdentificationError
from identification.built_system import BuiltSystem
from identification.linear.model import LinearModel
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.interface import Interface
from orchestrator.system import dotted_values
from orchestrator.trace import FloatArray

SAMPLES = 64  # of an answer
HEIGHT = 1e-3  # of a pulse, in the input's unit
RANK = 1e-8  # singular value, of the largest answer, below which a state is rounding
ALIKE = 1e-4  # of the answer's size, how far the check may be off


class FmuController:
    """The matrices of a sampled controller's FMU for values of its parameters.

    Attributes:
        inputs, outputs: its real variables.

    Raises:
        InputError: it cannot be run, or is not linear where it rests.
    """

    def __init__(self, name: str, spec: ComponentSpec, interface: Interface, step: Fraction) -> None:
        self.name, self._step = name, step
        self.inputs = tuple(port.name for port in interface.of("input") if port.real)
        self.outputs = tuple(port.name for port in interface.of("output") if port.real)
        if not (self.inputs and self.outputs):
            raise IdentificationError(name, "has no real inputs and outputs", "choose a controller")
        self._rest = np.array([float(interface.ports[own].start or 0.0) for own in self.inputs])
        stimulated = [f"{name}.{own}" for own in self.inputs]
        self._built = BuiltSystem(SystemSpec({name: spec}), stimulated)
        opened = OpenSystem(self._built.assembled)
        self._simulation: Simulation = opened.simulation(Timing(step * SAMPLES, step))
        weakref.finalize(self, opened.close)  # and the simulation with it
        self.require_slopes({})

    def step(self, values: Mapping[str, float]) -> float:
        """Its sampling time [s]."""
        return float(self._step)

    def linear(self, values: Mapping[str, float]) -> LinearModel:
        """The controller with these parameters over its own.

        Raises:
            FmuError: it does not take them.
        """
        resting = self._answer(values, np.zeros((SAMPLES, len(self.inputs))))
        answers = []
        for number in range(len(self.inputs)):
            pulse = np.zeros((SAMPLES, len(self.inputs)))
            pulse[0, number] = HEIGHT
            answers.append((self._answer(values, pulse) - resting) / HEIGHT)
        return _realised(np.stack(answers, axis=2), float(self._step), self.inputs, self.outputs)

    def require_slopes(self, values: Mapping[str, float]) -> None:
        """See that it is as good as linear with these parameters.

        Raises:
            IdentificationError: random inputs have other answers than its linear model.
        """
        model = self.linear(values)
        given = HEIGHT * np.random.default_rng(0).standard_normal((SAMPLES, len(self.inputs)))
        still = self._answer(values, np.zeros_like(given))
        seen = self._answer(values, given) - still
        told = model.simulate(given) if model.order else given @ model.d.T
        size = np.abs(told).max(axis=0) + np.abs(seen).max(axis=0)
        off = np.abs(seen - told).max(axis=0) > ALIKE * size + 1e-12
        if off.any():
            output = self.outputs[int(np.argmax(off))]
            problem = "is not linear where the controller rests"
            fix = "switch off what is not by its parameters, such as friction compensation or rounding, for tuning"
            raise IdentificationError(f"{self.name}.{output}", problem, fix)

    def _answer(self, values: Mapping[str, float], beside: FloatArray) -> FloatArray:
        """(K, w) outputs from the sample on at which they are made, under inputs (K, v) beside those at rest."""
        driven = np.vstack([self._rest + beside, self._rest])
        stimuli = {f"{self.name}.{own}": column for own, column in zip(self.inputs, driven.T, strict=True)}
        record = [f"{self.name}.{own}" for own in self.outputs]
        given = {**self._built.assembled.system.values(), **dotted_values(self.name, values)}
        trace = self._simulation.run(given, stimuli, record).trace
        return np.column_stack([trace[signal][1:] for signal in record])


def _realised(markov: FloatArray, step: float, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
    """The least model with these Markov parameters (K, w, v), the first of which is D."""
    d, later = markov[0], markov[1:]
    half, (rows, columns) = len(later) // 2, d.shape
    numbers = np.arange(half)[:, None] + np.arange(half)
    hankel, shifted = (later[numbers + late].swapaxes(1, 2).reshape(half * rows, half * columns) for late in (0, 1))
    u, s, vt = np.linalg.svd(hankel, full_matrices=False)
    kept = s > RANK * max(float(np.abs(markov).max()), 1e-300)
    root = np.sqrt(s[kept])
    observability, reachability = u[:, kept] * root, root[:, None] * vt[kept]
    a = (u[:, kept] / root).T @ shifted @ (vt[kept].T / root)
    return LinearModel(a, reachability[:, :columns], observability[:rows], d, step, inputs, outputs)
