"""Whether a change acts in a run: whether it moves any signal by more than the run's own steps do.

Half the step moves the signals, too. A method of first order, which a drive that is held over each step makes of any
solver, is then still off by as much as that has moved them, so that a run as it is is off by twice as much; of what a
change does, no more than that can be told from the error.
"""

from __future__ import annotations

import numpy as np

from orchestrator.measures.parting import distances
from orchestrator.trace import FloatArray, Trace

FIRST_ORDER = 2.0  # the error of a run over what half its step changes


def acts(changed: Trace, plain: Trace, halved: Trace | None) -> bool:
    """Whether what a change makes of a run differs from it by more than its error, in some signal: in its largest
    difference or in the root of its mean square.

    Args:
        changed, plain: the run with the change and without it.
        halved: the run with half the step, at twice the instants; None where it has none: then every difference counts.
    """
    if len(changed) != len(plain):
        return True
    finer = None if halved is None else halved.rows(slice(None, None, 2))
    return any(_above(changed, plain, finer, name) for name in plain.names)


def _above(changed: Trace, plain: Trace, finer: Trace | None, name: str) -> bool:
    effect = distances(changed[name], plain[name])
    if not effect.any():
        return False
    count = 0 if finer is None else min(len(finer), len(plain))
    error = np.zeros(1) if finer is None or not count else distances(finer[name][:count], plain[name][:count])
    return _largest(effect) > FIRST_ORDER * _largest(error) or _rms(effect) > FIRST_ORDER * _rms(error)


def _largest(difference: FloatArray) -> float:
    return float(difference.max())


def _rms(difference: FloatArray) -> float:
    return float(np.sqrt(np.mean(difference**2)))
