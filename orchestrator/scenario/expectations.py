"""What must hold in a run: limits, values, closeness to a reference, or that the run is refused for a reason."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import model_validator

from fmus.errors import ScenarioError, ServotwinError
from orchestrator import formats
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block


class ReferenceBlock(Block):
    """A signal of a trace file that a recorded one must follow."""

    file: Path
    signal: str


class Expectation(Block):
    """A condition on one recorded variable between two times, or on the failure of the run.

    Exactly one of `near` (with `within`), `below`, `above`, `reference` (with `within`) and `refused` is given;
    `within` is in the signal's unit.
    """

    signal: str | None = None
    after: float | None = None
    before: float | None = None
    near: float | None = None
    reference: ReferenceBlock | None = None
    within: float | None = None
    below: float | None = None
    above: float | None = None
    refused: str | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Expectation:
        kinds = [kind for kind in ("near", "reference", "below", "above", "refused") if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError("give one of near, reference, below, above, refused")
        if (self.within is None) != (kinds[0] not in ("near", "reference")):
            raise ValueError("`within` goes with `near` and `reference`")
        if (self.signal is None) != (kinds[0] == "refused"):
            raise ValueError("`signal` goes with everything but `refused`")
        return self


@dataclass(frozen=True)
class Check:
    """How an expectation turned out: what was asked, whether it held, and the figure that decided."""

    text: str
    held: bool
    found: str


def check(expectation: Expectation, trace: Trace | None, error: ServotwinError | None, base: Path) -> Check:
    """Judge one expectation on the trace of a run, or on the error that ended it.

    Raises:
        ScenarioError: the signal was not recorded, or there is no sample between the times.
    """
    if expectation.refused is not None:
        found = str(error) if error is not None else "the run went through"
        held = error is not None and expectation.refused in str(error)
        return Check(f"refused because of '{expectation.refused}'", held, found)
    text = _describe(expectation)
    if trace is None:
        return Check(text, False, str(error))
    return _judge(expectation, text, trace, base)


def _judge(expectation: Expectation, text: str, trace: Trace, base: Path) -> Check:
    assert expectation.signal is not None
    time, values = _window(expectation, trace)
    unit = trace.unit(expectation.signal) or "1"
    unit = "" if unit == "1" else f" {unit}"
    if expectation.below is not None:
        return Check(text, bool(values.max() < expectation.below), f"largest {values.max():.6g}{unit}")
    if expectation.above is not None:
        return Check(text, bool(values.min() > expectation.above), f"smallest {values.min():.6g}{unit}")
    assert expectation.within is not None
    deviation = float(np.max(np.abs(values - _target(expectation, time, base))))
    return Check(text, deviation <= expectation.within, f"largest deviation {deviation:.3g}{unit}")


def _target(expectation: Expectation, time: FloatArray, base: Path) -> FloatArray:
    if expectation.reference is None:
        return np.full(len(time), expectation.near)
    reference = formats.read(base / expectation.reference.file).trace
    return reference.resampled(time)[expectation.reference.signal]


def _window(expectation: Expectation, trace: Trace) -> tuple[FloatArray, FloatArray]:
    assert expectation.signal is not None
    start = trace.time[0] if expectation.after is None else expectation.after
    stop = trace.time[-1] if expectation.before is None else expectation.before
    window = trace.select([expectation.signal]).between(start, stop)
    if not len(window):
        raise ScenarioError(
            f"expect {expectation.signal}",
            f"there is no sample from {start:g} to {stop:g} s",
            "correct `after` and `before`",
        )
    return window.time, window[expectation.signal]


def _describe(expectation: Expectation) -> str:
    parts = [str(expectation.signal)]
    if expectation.near is not None:
        parts.append(f"is {expectation.near:g} within {expectation.within:g}")
    if expectation.reference is not None:
        parts.append(
            f"follows {expectation.reference.signal} of {expectation.reference.file.name} within {expectation.within:g}"
        )
    for kind in ("below", "above"):
        if getattr(expectation, kind) is not None:
            parts.append(f"stays {kind} {getattr(expectation, kind):g}")
    for kind in ("after", "before"):
        if getattr(expectation, kind) is not None:
            parts.append(f"{kind} {getattr(expectation, kind):g} s")
    return " ".join(parts)
