"""Closed-loop poles as goals."""

from __future__ import annotations

import numpy as np

from identification.tuning.goals.goal import Goal, LoopTrial, Measure
from orchestrator.trace import FloatArray

FAST = 1e-6  # modulus below which a pole is gone within a sample, and has no damping to speak of


def damping(trial: LoopTrial, goal: Goal) -> FloatArray:
    """(N,) the least damping ratio of a closed-loop pole, of its counterpart in continuous time."""
    poles = trial.loops.poles
    logarithm = np.log(np.where(np.abs(poles) > FAST, poles, FAST))
    size = np.abs(logarithm)
    ratio = np.where(size > 0, -logarithm.real / np.where(size > 0, size, 1.0), 0.0)
    return np.asarray(ratio.min(axis=1))


def decay(trial: LoopTrial, goal: Goal) -> FloatArray:
    """(N,) [1/s] by which the slowest closed-loop pole fades."""
    return np.asarray(-np.log(np.maximum(trial.loops.radius, 1e-300)) / trial.loops.plants.step)


MEASURES: dict[str, Measure] = {
    "damping": Measure("1", damping, frozenset(), "least damping ratio of the closed loop's poles"),
    "decay rate": Measure("1/s", decay, frozenset(), "rate at which the slowest closed-loop pole fades"),
}
