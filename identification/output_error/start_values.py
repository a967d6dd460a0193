"""Start values that a study leaves to the FMUs although its recordings give them: said with the entry to write."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.units import conversion
from fmus.words import listed
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.study import HALF_WIDTH, OutputErrorStudy
from orchestrator.fmi.interface import Port
from orchestrator.system import Endpoint, System
from orchestrator.trace import FloatArray, Trace

_START = "_start"  # how the parameter of a state's start value is named
_FEWEST = 5  # samples that a reading takes
_VISIBLE, _CERTAIN = 0.1, 4.0  # how far off rest counts: of the spread, and in standard errors


@dataclass(frozen=True)
class UnreadStart:
    """A start value that nobody gives.

    Attributes:
        name: component.variable.
        value: what the FMU has [unit].
        output: the output whose derivative of that order it is, and `factor` to its unit.
        own: whether it is, by its name; otherwise it may go with it, as both ends of a gear do.
    """

    name: str
    unit: str
    value: float
    output: str
    derivative: int
    factor: float
    own: bool


def resting_inputs(study: OutputErrorStudy, traces: Sequence[Trace]) -> Iterator[str]:
    """A sentence about each input that rests in recordings, which are of what was let go."""
    for name, spec in study.run.inputs.items():
        if rest := [trace.name for trace in traces if not np.ptp(trace[spec.signal])]:
            yield f"inputs.{name} rests in {listed(rest, 3)}: there only ratios of what moves freely are told, no gains"


def unread_starts(study: OutputErrorStudy, system: System) -> list[UnreadStart]:
    """Those that an output of the study tells: the start of the output itself, or of what is named and measured as its
    derivative."""
    estimated = map(study.variable, study.parameters.names)
    known = {*study.run.initial, *estimated, *study.traces.values, *study.system.values()}
    found: dict[str, UnreadStart] = {}
    told = [start for output in study.outputs for start in _told(system, output) if start.name not in known]
    for start in sorted(told, key=lambda start: (not start.own, start.derivative)):
        found.setdefault(start.name, start)
    return list(found.values())


def _told(system: System, output: str) -> Iterator[UnreadStart]:
    component, measured = Endpoint.parse(output).component, system.port(Endpoint.parse(output))
    for port in system.parts[component].interface.ports.values():
        state = port.name.removesuffix(_START)
        same, akin = state == measured.name, _akin(state, measured.name)
        for derivative in (0, 1):
            factor = _factor(measured, port, derivative)
            if factor and (akin or (same and not derivative)) and _settable(port):
                start, unit, own = float(port.start or 0.0), port.unit or "1", same or derivative > 0
                yield UnreadStart(f"{component}.{port.name}", unit, start, output, derivative, factor, own)


def _settable(port: Port) -> bool:
    """Whether it is the start value of a state."""
    state = port.causality in ("output", "local") or (port.causality == "parameter" and port.name.endswith(_START))
    return port.real and port.start is not None and state


def _akin(one: str, other: str) -> bool:
    """Whether two names differ in one word: load_speed and load_angle."""
    words, others = re.split(r"[_.]", one), re.split(r"[_.]", other)
    return len(words) == len(others) and sum(a != b for a, b in zip(words, others, strict=True)) == 1


def _factor(measured: Port, port: Port, derivative: int) -> float | None:
    source, target = measured.measure.rate(derivative).unit, port.measure.unit
    found = conversion(source, target) if source and target else None
    return found.factor if found else None


def start_warnings(
    study: OutputErrorStudy, starts: Sequence[UnreadStart], traces: Sequence[Trace], windows: Sequence[FreeRunWindow]
) -> list[str]:
    """A sentence about each that windows of these traces begin away from."""
    interval = max(float(np.quantile(np.diff(trace.time), 0.99)) for trace in traces)
    half_width = max(HALF_WIDTH, 2.5 * interval)  # a parabola's three samples on one side
    said = []
    for start in starts:
        readings = _readings(windows, study.outputs.index(start.output), start.derivative, half_width)
        if readings is None:
            continue
        off = start.factor * np.abs(readings.first - start.value / start.factor)
        away = off > start.factor * max(_VISIBLE * readings.spread, _CERTAIN * readings.error)
        if away.any():
            begin = f"{int(away.sum())} of {len(windows)} windows begin away from"
            said.append(f"{begin} {_sentence(start, float(off.max()), _entry(study, start, half_width))}")
    return said


def _sentence(start: UnreadStart, most: float, keys: str) -> str:
    value, entry = f"{start.name} = {start.value:g} {start.unit}", f"`initial: {start.name}: {keys}`"
    if start.own:
        return f"{value}, by up to {most:.3g}: add {entry} (and `estimated: true` where it is too noisy to read)"
    return f"rest, but all with {value}: if that goes with {start.output} (by a gear, its `factor`), add {entry}"


def _entry(study: OutputErrorStudy, start: UnreadStart, half_width: float) -> str:
    spec = study.run.outputs[start.output]
    keys = [f"signal: {spec.signal}"]
    if spec.given.factor is not None:
        keys.append(f"factor: {spec.given.factor * start.factor:.6g}")
    if start.derivative:
        keys.append(f"derivative: {start.derivative}")
    if half_width > HALF_WIDTH:
        keys.append(f"half_width: {half_width:.2g}")
    if not start.own:
        keys.append("estimated: true")
    return "{" + ", ".join(keys) + "}"


@dataclass(frozen=True)
class _Readings:
    """An output or its derivative read by parabolas: at the beginning of each window (W,), with the standard error of
    one, and how widely it is spread over all."""

    first: FloatArray
    error: float
    spread: float


def _readings(windows: Sequence[FreeRunWindow], column: int, derivative: int, half_width: float) -> _Readings | None:
    """None where windows are too short."""
    step = max(float(np.median(np.diff(window.time))) for window in windows)
    count = max(_FEWEST, math.ceil(2 * half_width / step) + 1)
    if min(len(window.measured) for window in windows) < count:
        return None
    basis = np.vander(step * np.arange(count), 3, increasing=True)
    fitting = np.linalg.pinv(basis)
    pieces = [window.measured[: len(window.measured) // count * count, column].reshape(-1, count) for window in windows]
    everything = np.concatenate(pieces)
    coefficients = everything @ fitting.T
    noise = float(np.sum((everything - coefficients @ basis.T) ** 2)) / (len(everything) * (count - 3))
    error = math.sqrt(noise * float(fitting[derivative] @ fitting[derivative]))
    first = np.array([piece[0] @ fitting[derivative] for piece in pieces])
    return _Readings(first, error, float(coefficients[:, derivative].std()))
