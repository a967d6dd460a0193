"""How fast frames become a trace and a trace frames, beside a plain cantools loop; and a day of log in a stream.

The database is generated: three messages of a rig, 16-bit numbers and floats, at 1 kHz and 100 Hz. Frames come one
after the other, as on a bus, so that each makes a row of the trace.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import cantools
import numpy as np

from orchestrator.can.codec import decoding
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.merging import Merger
from orchestrator.can.codec.streams import FrameStream
from orchestrator.can.database import database
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.writing import Declared, generate
from orchestrator.can.frames import Frames
from orchestrator.trace import Trace

from ..figure import Figure
from ..simulation.loop_endurance import resources

DECODED, ENCODED, TIMES_CANTOOLS = 2e6, 3e5, 20
FRAMES, PLAIN, REPEATS = 1_000_000, 50_000, 5
DAY = 86_400.0  # [s]
MEMORY_LIMIT = 4e6  # [B]
SIGNALS = [
    Declared("angle", "rad", -10, 10, every=0.001),
    Declared("speed", "rad/s", -200, 200, every=0.001),
    Declared("torque", "N.m", every=0.001),
    Declared("voltage", "V", -24, 24, every=0.001, sender="Controller"),
    Declared("setpoint", "rad", -10, 10, every=0.001, sender="Controller"),
    Declared("temperature", "K", 200, 400, every=0.01),
    Declared("current", "A", -20, 20, every=0.01),
]


def figures() -> list[Figure]:
    """Rates of decoding and encoding, and the ratio to cantools in the same run."""
    base, trace = rig(), recorded(FRAMES / 2100)
    encoder = Encoder(base, trace.names)
    log = queued(encoder.encode(trace))
    encoded = len(log) / timed(lambda: encoder.encode(trace))
    decoded = len(log) / timed(lambda: decoding.trace([log], LogDatabase(base)))
    decoding_alone, plain = cantools_rates(base, log[:PLAIN])
    return [
        Figure(
            f"{len(log):,} frames in memory to a trace, a core",
            f"at least {DECODED:,.0f} a second",
            f"{decoded:,.0f} a second",
            decoded >= DECODED,
        ),
        Figure("a plain cantools loop to the same trace", "-", f"{plain:,.0f} a second"),
        Figure(
            "to a trace, against that",
            f"at least {TIMES_CANTOOLS} times",
            f"{decoded / plain:.0f} times",
            decoded >= TIMES_CANTOOLS * plain,
        ),
        Figure("a plain cantools loop that keeps nothing", "-", f"{decoding_alone:,.0f} a second"),
        Figure(
            "values that are not cantools' to the last bit",
            "0",
            f"{different(base, log[:PLAIN])}",
            different(base, log[:PLAIN]) == 0,
            certain=True,
        ),
        Figure(
            "a trace to frames", f"at least {ENCODED:,.0f} a second", f"{encoded:,.0f} a second", encoded >= ENCODED
        ),
    ]


def endurance() -> list[Figure]:
    """Memory over a day's frames."""
    base, trace = rig(), recorded((1 << 16) / 2000)
    return streamed(base, queued(Encoder(base, trace.names).encode(trace))[: 1 << 16], DAY)


def rig() -> database.Database:
    """The generated database."""
    with tempfile.TemporaryDirectory() as folder:
        generate(SIGNALS, Path(folder) / "rig.dbc")
        return database.load(Path(folder) / "rig.dbc")


def recorded(seconds: float) -> Trace:
    """Random signals at 1 kHz, most of them within their ranges."""
    rng = np.random.default_rng(0)
    time = 0.001 * np.arange(int(1000 * seconds))
    columns = {each.name: (each.maximum or 5) * np.sin(rng.normal(size=len(time)).cumsum() / 30) for each in SIGNALS}
    return Trace(time, columns | {"temperature": 300 + columns["temperature"] / 10})


def timed(action: Callable[[], object]) -> float:
    """Median processor time [s], which other programs hardly change."""
    times = []
    for _ in range(REPEATS):
        begun = process_time()
        action()
        times.append(process_time() - begun)
    return median(times)


def queued(log: Frames) -> Frames:
    """The frames with the stamps that a bus at 500 kbit/s gives them, 250 us for each."""
    number = np.arange(len(log)) * 250e-6
    return replace(log, time=number + np.maximum.accumulate(log.time - number))


def cantools_rates(base: database.Database, log: Frames) -> tuple[float, float]:
    """Frames a second of a loop that decodes each, and of one that also makes the trace."""
    raw = cantools.database.can.Database([each.raw for each in base.messages])
    messages = list(log.messages())
    names = [each.name for each in SIGNALS]

    def decode() -> None:
        for message in messages:
            raw.decode_message(message.arbitration_id, message.data, decode_choices=False)

    def to_trace() -> Trace:
        held: dict[str, float] = {}
        time, rows = [], []
        for message in messages:
            held.update(raw.decode_message(message.arbitration_id, message.data, decode_choices=False))
            if len(held) == len(names):
                time.append(message.timestamp)
                rows.append([held[name] for name in names])
        columns = np.array(rows).T
        return Trace(np.array(time), dict(zip(names, columns, strict=True)))

    return len(messages) / timed(decode), len(messages) / timed(to_trace)


def different(base: database.Database, log: Frames) -> int:
    """Number of values that differ from cantools'."""
    decoded, wrong = decoding.Decoder(LogDatabase(base)).feed(log), 0
    for message in base.messages:
        own = log[log.id == message.id]
        expected = [message.raw.decode(each.data, decode_choices=False) for each in own.messages()]
        for name, values in decoded[FrameStream(message.name, "can0")].values.items():
            wrong += int(np.count_nonzero(values != [each[name] for each in expected]))
    return wrong


def streamed(base: database.Database, batch: Frames, seconds: float) -> list[Figure]:
    """Frames of a long log through decoder and merger, the same batch over and over with later stamps."""
    decoder, merger = decoding.Decoder(LogDatabase(base)), Merger([each.name for each in SIGNALS])
    period = float(batch.time[-1] - batch.time[0]) + 0.001
    count, rows, begun, memory, most = int(seconds / period) + 1, 0, perf_counter(), 0, 0
    for number in range(count):
        rows += len(merger.feed(decoder.feed(replace(batch, time=batch.time + number * period))))
        if number == count // 20:
            memory = resources()[0]
        elif number % 50 == 0:
            most = max(most, resources()[0])
    gain = max(most, resources()[0]) - memory
    name = f"{seconds / 3600:g} h of log, {count * len(batch):,} frames, streamed"
    return [
        Figure(
            f"{name}: memory gained", f"under {MEMORY_LIMIT / 1e6:.0f} MB", f"{gain / 1e6:.2f} MB", gain < MEMORY_LIMIT
        ),
        Figure(f"{name}: time", "-", f"{perf_counter() - begun:.1f} s, {rows:,} rows"),
    ]
