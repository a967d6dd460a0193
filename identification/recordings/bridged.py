"""What the manifest of a coupling tells of its record: when inputs had safe values, and when outputs rested."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel, ValidationError

from orchestrator.marks import Mark

LARGEST = 16 << 20  # bytes; a manifest has at most a thousand events
BEGINS, ENDS = {"silent", "rests"}, {"first", "back", "runs"}


class _Event(BaseModel):
    time: float
    name: str
    kind: str


class _Peer(BaseModel):
    first: float | None
    silence: float


class _Watchdog(BaseModel):
    messages: dict[str, _Peer]
    event_count: int
    events: list[_Event]


class _Bus(BaseModel):
    watchdog: _Watchdog


class _Case(BaseModel):
    trace: str | None = None


class _Manifest(BaseModel):
    cases: list[_Case]
    can: _Bus


def safe_stretches(file: Path, end: float) -> list[Mark]:
    """The stretches of a coupling's record, until `end` [s], in which an input had its safe value or an output rested.

    None where the file is no such record: where no manifest beside it names it.
    """
    manifest = file.parent / "manifest.json"
    try:
        if not manifest.is_file() or manifest.stat().st_size > LARGEST:
            return []
        told = _Manifest.model_validate(json.loads(manifest.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError, ValidationError):
        return []
    if file.name not in [case.trace for case in told.cases]:
        return []
    return [Mark("safe", start, stop) for start, stop in _stretches(told.can.watchdog, end) if start < stop]


def _stretches(watchdog: _Watchdog, end: float) -> Iterator[tuple[float, float]]:
    for peer in watchdog.messages.values():
        yield 0.0, end if peer.first is None else peer.first
    latest = max((peer.silence for peer in watchdog.messages.values()), default=0.0)
    since: dict[str, float] = {}
    for event in watchdog.events:
        if event.kind in BEGINS:
            known = watchdog.messages.get(event.name)
            held = 0.0 if event.kind == "rests" else known.silence if known else latest
            since.setdefault(event.name, max(event.time - held, 0.0))
        elif event.kind in ENDS and event.name in since:
            yield since.pop(event.name), event.time
    untold = watchdog.events[-1].time if watchdog.event_count > len(watchdog.events) else end
    yield min([untold, *since.values()]), end
