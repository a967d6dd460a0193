"""The traces of a campaign in common units, for methods that take signals as they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from fmus.errors import WiringError
from fmus.units import SAME
from identification.recordings.campaign import StudyTrace
from orchestrator.crossing import CrossingDocument, NamedUnit, crossing, documents_of, named, noted
from orchestrator.trace import Trace


def in_common_units(recorded: Sequence[StudyTrace], signals: Iterable[str]) -> list[StudyTrace]:
    """The traces, each of these signals in the unit of the first trace that tells one.

    Raises:
        WiringError: a unit of another quantity; the message names the trace.
    """
    told = {signal: [known.trace.unit(signal) for known in recorded] for signal in signals}
    return in_units(recorded, {signal: named(next(filter(None, units), None)) for signal, units in told.items()})


def in_units(recorded: Iterable[StudyTrace], units: Mapping[str, NamedUnit]) -> list[StudyTrace]:
    """The traces with these signals in these units, and how they got there in `crossings`.

    Raises:
        WiringError: a unit of another quantity; the message names the trace.
    """
    return [_in_units(known, units) for known in recorded]


def unit_documents(recorded: Iterable[StudyTrace]) -> list[CrossingDocument]:
    """What there is to be told of the units of the traces."""
    return documents_of(noted(crossed for known in recorded for crossed in known.crossings))


def _in_units(known: StudyTrace, units: Mapping[str, NamedUnit]) -> StudyTrace:
    trace, crossings = known.trace, []
    for signal in units.keys() & set(trace.names):
        unit = units[signal]
        try:
            crossings.append(crossing(signal, named(trace.unit(signal)), unit))
        except WiringError as error:
            raise WiringError(f"{known.place}: {signal}", error.problem, error.fix) from error
        change = crossings[-1].conversion
        values = trace.signals if change == SAME else {**trace.signals, signal: change(trace[signal])}
        trace = Trace(
            trace.time, values, {**trace.units, **({signal: unit.name} if unit.name else {})}, trace.name, trace.texts
        )
    return replace(known, trace=trace, crossings=tuple(crossings))
