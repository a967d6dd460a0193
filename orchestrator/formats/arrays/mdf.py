"""Measurements in MDF files (.mf4, .mdf, .dat), versions 3 and 4, for which the extra `mf4` installs asammdf.

They are read in a process of its own: asammdf may crash, hang or fill the memory on a damaged one.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from fmus.errors import TraceError
from orchestrator.formats.arrays.channels import ArrayChannel, distinct, recording
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording
from orchestrator.trace import FloatArray

PATIENCE = 300.0  # [s]
MEMORY = 4 << 30  # bytes
_BOOT = "import sys; sys.path[:] = {path!r}; from orchestrator.formats.arrays.mdf import serve; serve(sys.argv[1])"


def read(path: Path, layout: Layout) -> Recording:
    """The wanted channels, of those groups whose stamps are the same.

    Raises:
        TraceError: asammdf is not there, or the file is damaged or holds no channels.
    """
    if find_spec("asammdf") is None:
        raise TraceError(path, "an MDF file needs asammdf", "pip install servotwin[mf4]")
    told, arrays = _served(path)
    clocks: dict[str, FloatArray] = {}
    channels = []
    for number, (name, unit, group) in enumerate(told["channels"]):
        master = arrays[f"time_{group}"]
        clock = next((key for key, known in clocks.items() if np.array_equal(known, master)), "")
        if not clock:
            clock = "time" if not clocks else f"time_{len(clocks) + 1}"
            clocks[clock] = master
            channels.append(_channel(clock, "s", master, clock))
        channels.append(_channel(name, unit, arrays[f"channel_{number}"], clock))
    if not channels:
        raise TraceError(path, "holds no measured channels", "record or export it again")
    read = recording(path, layout, distinct(channels), told["notes"])
    return replace(read, start=told["start"])


def _channel(name: str, unit: str, values: Any, clock: str) -> ArrayChannel:
    problem = "" if values.dtype.kind in "biuf" and values.ndim == 1 else "text or arrays"
    return ArrayChannel(name, unit, len(values), lambda: values, clock, problem=problem)


class _Told(TypedDict):
    channels: list[tuple[str, str, int]]
    notes: list[str]
    start: float


def _served(path: Path) -> tuple[_Told, Mapping[str, np.ndarray]]:
    command = [sys.executable, "-c", _BOOT.format(path=sys.path), str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE, stdin=subprocess.DEVNULL, check=False)
        arrays = np.load(io.BytesIO(done.stdout), allow_pickle=False)
        return json.loads(str(arrays["told"])), arrays
    except subprocess.TimeoutExpired:
        raise TraceError(path, "keeps asammdf busy without end", "record or export it again") from None
    except (ValueError, EOFError, KeyError, OSError):
        raise TraceError(path, "is damaged: asammdf cannot read it", "record or export it again") from None


def serve(path: str) -> None:
    """Write the channels of a file to standard output as .npz: in the process that `read` starts."""
    if sys.platform != "win32":
        import resource  # noqa: PLC0415 (of Unix)

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    from asammdf import MDF  # noqa: PLC0415 (of an extra)

    out, sys.stdout = sys.stdout.buffer, sys.stderr
    arrays: dict[str, Any] = {}
    channels: list[tuple[str, str, int]] = []
    notes: list[str] = []
    with MDF(path) as file:
        for group, _ in enumerate(file.groups):
            for signal in _signals(file, group, notes):
                arrays.setdefault(f"time_{group}", np.asarray(signal.timestamps, dtype=float))
                samples = _valid(signal, notes)
                usable = samples.dtype.kind in "biuf" and samples.ndim == 1
                arrays[f"channel_{len(channels)}"] = samples if usable else np.zeros(len(samples), "U1")
                channels.append((signal.name, signal.unit or "", group))
        start = file.header.start_time.timestamp()
    arrays["told"] = np.array(json.dumps({"channels": channels, "notes": notes, "start": start}))
    np.savez(out, **arrays)


def _valid(signal: Any, notes: list[str]) -> Any:
    """Its samples (K,), without a value where the file marks them invalid: all of a group share its stamps."""
    samples, invalid = signal.samples, signal.invalidation_bits
    if invalid is None or not invalid.any() or samples.dtype.kind not in "biuf" or samples.ndim != 1:
        return samples
    notes.append(f"channel '{signal.name}': {np.count_nonzero(invalid)} samples are marked invalid and have no value")
    return np.where(invalid, np.nan, samples.astype(float))


def _signals(file: Any, group: int, notes: list[str]) -> Iterator[Any]:
    for index, channel in enumerate(file.groups[group].channels):
        if index == file.masters_db.get(group):
            continue
        try:
            signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
        except Exception as problem:  # whatever a library makes of damage
            notes.append(f"channel '{channel.name}' cannot be read ({str(problem)[:80]})")
            continue
        if len(signal.samples):
            yield signal
        missing = np.isnan(signal.samples) if signal.samples.dtype.kind == "f" else np.zeros(1, bool)
        if channel.conversion is not None and missing.any():
            raw = file.get(group=group, index=index, raw=True, ignore_invalidation_bits=True).samples
            if raw.dtype.kind in "biuf" and (texts := np.count_nonzero(missing & np.isfinite(raw))):
                notes.append(f"channel '{channel.name}': {texts} samples stand for texts, and have no value")
