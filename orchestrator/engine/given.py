"""What a run is given: values of parameters, and stimuli."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fmus.errors import WiringError
from orchestrator.fmi.interface import Value
from orchestrator.settable import Settable, settable
from orchestrator.system import System
from orchestrator.trace import FloatArray


class GivenValues:
    """What runs of one system are given, checked: values by name, and stimuli side by side.

    Args:
        stimuli: component.input of those that a run needs, sorted.
    """

    def __init__(self, system: System, stimuli: Sequence[str]) -> None:
        self._system, self._stimuli = system, stimuli
        self._settable: dict[str, Settable] = {}

    def values(self, values: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
        """component -> variable -> value; names are looked up when they come for the first time.

        Raises:
            WiringError: a run cannot be given one.
        """
        own: dict[str, dict[str, Value]] = {name: {} for name in self._system.parts}
        for name, value in values.items():
            known = self._settable.get(name)
            if known is None:
                known = self._settable[name] = settable(self._system, name)
            if isinstance(value, str) or not known.lowest <= value <= known.highest:
                known.check(value)
            own[known.component][known.variable] = value
        return own

    def driven(self, stimuli: Mapping[str, FloatArray], count: int) -> FloatArray:
        """(count, s) the stimuli side by side, in their order.

        Raises:
            WiringError: others are wanted, or they are too short or not finite.
        """
        if (given := sorted(stimuli)) != [*self._stimuli]:
            raise WiringError("stimuli", f"{given} given", f"give {[*self._stimuli]}")
        columns = []
        for name in self._stimuli:
            samples = np.asarray(stimuli[name], dtype=float)
            if samples.ndim != 1 or len(samples) < count:
                raise WiringError(name, f"has samples of shape {samples.shape}", f"give {count}, one an instant")
            finite = np.isfinite(samples)
            if not finite[finite.argmin()]:  # the first that is not, found sooner than by `all` in a short run
                raise WiringError(name, "is driven by a sample that is not finite", "repair the stimulus")
            columns.append(samples[:count])
        side_by_side = np.empty((count, len(columns)))
        for place, samples in enumerate(columns):
            side_by_side[:, place] = samples
        return side_by_side
