"""What output-error estimation is asked: windows of measured outputs, and what may move to match them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.arrow_least_squares import LEAST_SQUARES, Box, Loss, Point
from identification.estimation.groups import Grouped, own_slopes, own_values
from identification.estimation.parameters import InitialState, ParameterSet, refuse_duplicates
from identification.signals.resolution import ROUNDED
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Window(ReadOnlyArrays):
    """A stretch of one trace that is simulated freely from its first instant.

    Attributes:
        name: for messages and reports.
        trace: name of the trace it was cut from.
        measured: (K, m) outputs at the measured instants, one column an output.
        weight: (m,) what an output's error is multiplied by, 1 / its unit.
        resolution: (m,) step in which each output was recorded, 0 for none; None where that is not known.
    """

    name: str
    trace: str
    measured: FloatArray
    weight: FloatArray
    resolution: FloatArray | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.measured.ndim != 2 or len(self.measured) < 2 or not self.measured.size:
            raise IdentificationError(
                self.name, f"measured has shape {self.measured.shape}, not (K, m)", "give two instants or more"
            )
        if not np.all(np.isfinite(self.measured)):
            raise IdentificationError(self.name, "a measured output is not finite", "repair or cut the trace")
        if self.weight.shape != self.measured.shape[1:]:
            raise IdentificationError(
                self.name, f"weight has shape {self.weight.shape} for {self.measured.shape[1]} outputs"
            )
        if not np.all((self.weight > 0) & np.isfinite(self.weight)):
            raise IdentificationError(self.name, "a weight is not positive", "weigh every output above 0")

    @property
    def steps(self) -> FloatArray:
        """(K,) when the measured instants are, in steps of the free run."""
        return np.arange(len(self.measured), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Problem:
    """Which parameters and initial states shall match which windows, and in which norm.

    Attributes:
        outputs: names of the outputs, in the order of the windows' columns.
        initial_states: one start value a window each, fixed or estimated.
        loss: of the weighted residuals; the robust ones bend at `loss.scale`.
        grouped: parameters with a value of their own in each group of traces.
        counted: how many windows a sample is in, on average over all samples; more than 1 where windows overlap.

    Raises:
        IdentificationError: names, windows and start values do not fit together.
    """

    parameters: ParameterSet
    windows: tuple[Window, ...]
    outputs: tuple[str, ...]
    initial_states: tuple[InitialState, ...] = ()
    loss: Loss = LEAST_SQUARES
    grouped: tuple[Grouped, ...] = ()
    counted: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(self.windows))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        object.__setattr__(self, "initial_states", tuple(self.initial_states))
        if not self.windows:
            raise IdentificationError("windows", "there are none", "cut at least one from a trace")
        refuse_duplicates((*self.parameters.names, *(state.name for state in self.initial_states)))
        for window in self.windows:
            if window.measured.shape[1] != len(self.outputs):
                names = ", ".join(self.outputs)
                raise IdentificationError(
                    window.name, f"has {window.measured.shape[1]} measured columns for the outputs {names}"
                )
        for state in self.initial_states:
            if len(state.start) != len(self.windows):
                raise IdentificationError(
                    state.name,
                    f"has {len(state.start)} start values for {len(self.windows)} windows",
                    "give one a window",
                )
        if self.samples <= self.unknowns:
            raise IdentificationError(
                "windows",
                f"hold {self.samples} samples for {self.unknowns} unknowns",
                "add windows or fix parameters",
            )

    @property
    def estimated(self) -> tuple[InitialState, ...]:
        """The initial states that are fitted, one value a window."""
        return tuple(state for state in self.initial_states if state.estimated)

    @property
    def samples(self) -> int:
        """Measured values in all windows together."""
        return sum(window.measured.size for window in self.windows)

    @property
    def unknowns(self) -> int:
        """Free parameters, and estimated initial states of all windows together."""
        return len(self.parameters.free) + len(self.estimated) * len(self.windows)

    @property
    def rounding(self) -> FloatArray:
        """(m,) variance of the outputs' rounding, weighted, its mean over the windows."""
        steps = [np.zeros(len(self.outputs)) if w.resolution is None else w.weight * w.resolution for w in self.windows]
        return np.asarray(np.mean(np.square(steps), axis=0) * ROUNDED**2)

    def measured_only(self, residuals: Sequence[FloatArray], windows: Sequence[int]) -> list[FloatArray]:
        """The residuals of these windows without what stands behind those of the first."""
        return [residual[: self.windows[w].measured.size] for w, residual in zip(windows, residuals, strict=True)]

    def values(self, window: int, point: Point, row: int) -> dict[str, float]:
        """name -> value for one window, its initial states taken from this row of the point."""
        known = own_values(self.grouped, self.windows[window].trace, self.parameters.values(point.parameters))
        return known | self.initial_values(window, point.states[row])

    def slopes(self, window: int, point: Point) -> list[dict[str, float]]:
        """Each free parameter's slope of the values that one window is given, by name; ties follow."""
        found = []
        for parameter, slope in zip(self.parameters.free, self.parameters.slopes(point.parameters), strict=True):
            moved = {parameter.name: float(slope)}
            moved |= {
                tie.name: tie.factor * float(slope) for tie in self.parameters.ties if tie.other == parameter.name
            }
            found.append(own_slopes(self.grouped, self.windows[window].trace, moved))
        return found

    def acting(self, window: int) -> list[bool]:
        """Which free parameters, and estimated initial states, one window depends on."""
        unit = self.start([window])
        return [*map(bool, self.slopes(window, unit)), *(True for _ in self.estimated)]

    def with_all_groups(self, windows: Sequence[int]) -> tuple[int, ...]:
        """These windows, and the first of each group that has none among them."""
        chosen = dict.fromkeys(windows)
        for one in self.grouped:
            for group in one.members:
                own = [w for w, window in enumerate(self.windows) if one.traces.get(window.trace) == group]
                if own and not any(w in chosen for w in own):
                    chosen[own[0]] = None
        return tuple(sorted(chosen))

    def initial_values(self, window: int, z: FloatArray) -> dict[str, float]:
        """name -> start value of one window at z (s,)."""
        values = {state.name: state.start[window] for state in self.initial_states}
        return values | {s.name: s.value(window, float(zi)) for s, zi in zip(self.estimated, z, strict=True)}

    def start(self, windows: Sequence[int]) -> Point:
        """The declared start of these windows, in z."""
        return Point(np.zeros(len(self.parameters.free)), np.zeros((len(windows), len(self.estimated))))

    def point(self, values: Mapping[str, float], starts: Mapping[str, Sequence[float] | FloatArray]) -> Point:
        """Parameters by name, and start values (W,) of estimated initial states, of all windows in z."""
        states = [(np.asarray(starts[state.name]) - state.start) / state.size for state in self.estimated]
        return Point(self.parameters.z(values), np.array(states).reshape(len(states), len(self.windows)).T)

    def box(self, windows: Sequence[int]) -> Box:
        """The bounds of these windows, in z, and how far a step may go."""
        lower, upper = self.parameters.z_bounds
        shape = (len(self.estimated), len(self.windows))
        rows = list(windows)
        low = np.array([state.z_bounds[0] for state in self.estimated]).reshape(shape)
        high = np.array([state.z_bounds[1] for state in self.estimated]).reshape(shape)
        return Box(Point(lower, low.T[rows]), Point(upper, high.T[rows]), self.parameters.reach)

    def fixed_at(self, values: Mapping[str, float]) -> Problem:
        """The same question with all parameters fixed here: only initial states are left to fit."""
        return replace(self, parameters=self.parameters.fixed_at(values))


def spread_weights(measured: Sequence[FloatArray]) -> FloatArray:
    """(m,) weights that make outputs of different units comparable: 1 / standard deviation over all windows.

    Raises:
        IdentificationError: an output is constant.
    """
    spread = np.concatenate(list(measured)).std(axis=0)
    if not np.all((spread > 0) & (spread < math.inf)):
        column = int(np.flatnonzero(~(spread > 0) | ~np.isfinite(spread))[0])
        raise IdentificationError(f"output {column}", "is constant or not finite in all windows", "leave it out")
    return np.asarray(1.0 / spread)
