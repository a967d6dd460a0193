"""Lengths of time that a study gives in seconds or in samples of each recording."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, StringConstraints

from orchestrator.yaml_file import Seconds, exact

_ALIKE = 1e-6  # of a step
_SAMPLES = re.compile(r"\s*(\d{1,9})\s*samples?\s*")


@dataclass(frozen=True)
class Samples:
    """So many samples of a recording."""

    count: int

    def __str__(self) -> str:
        return f"{self.count} sample{'s' if self.count != 1 else ''}"


Span = Fraction | Samples  # Fraction [s]


def _read(value: Any) -> Any:
    found = _SAMPLES.fullmatch(value) if isinstance(value, str) else None
    return Samples(int(found[1])) if found else exact(value)


_Text = Annotated[str, StringConstraints(pattern=r"^\s*\d{1,9}\s*samples?\s*$")]
_written = PlainSerializer(lambda span: str(span) if isinstance(span, Samples) else span)
SpanEntry = Annotated[Fraction | Samples, BeforeValidator(_read, json_schema_input_type=Seconds | _Text), _written]
"""A time as studies hold it: seconds, or `512 samples` of the recording that it is about."""

WidthEntry = Annotated[
    float | Samples,
    BeforeValidator(lambda value: _number(_read(value)), json_schema_input_type=Seconds | _Text),
    _written,
]
"""The same where it need not be exact."""


def _number(span: Span) -> float | Samples:
    return span if isinstance(span, Samples) else float(span)


def amount(span: Span | float) -> Fraction | float:
    """Its size, to be compared with 0."""
    return span.count if isinstance(span, Samples) else span


def on_raster(span: Span, between: float, step: Fraction) -> Fraction:
    """How long it is [s]; samples, so far apart [s], are rounded to steps [s]; any take one at least."""
    if not isinstance(span, Samples):
        return span
    return max(round(Fraction(span.count) * Fraction(between) / step), min(span.count, 1)) * step


def lasting(span: Span | float, between: float) -> float:
    """How long it is [s], of samples so far apart [s]."""
    return span.count * between if isinstance(span, Samples) else float(span)


def at_most(span: Span, duration: Fraction, step: Fraction) -> Fraction:
    """How long it is [s]; samples, as long as a recording of this duration [s] by whole steps."""
    return math.ceil(duration / step) * step if isinstance(span, Samples) else span


def rounded(span: Span, between: float, step: Fraction) -> bool:
    """Whether so many samples end between two steps."""
    return abs(lasting(span, between) - float(on_raster(span, between, step))) > _ALIKE * float(step)


def stated(span: Span) -> str:
    """As a study says it."""
    return str(span) if isinstance(span, Samples) else f"{float(span):g} s"
