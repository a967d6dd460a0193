"""python-can's SQLite database of messages, read row by row from a file that nobody vouches for."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import can

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.can.frames import CLASSIC, Frames, from_messages
from orchestrator.can.logs.findings import Findings
from orchestrator.can.logs.messages import BATCH, oddity

ROWS = (
    "SELECT rowid, ts, arbitration_id, extended, remote, error, dlc, data FROM messages "
    "WHERE rowid >= ? ORDER BY rowid LIMIT ?"
)
TABLE = (
    "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, "
    "dlc INTEGER, data BLOB)"
)
MAX_VALUE = 1 << 16  # bytes of a row
LEAP = 64  # rows that are passed over behind a broken page; doubled while it stays broken


def frames(path: Path, findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches, in the order of their rows, and the share of those that is read by then.

    Raises:
        TraceError: it is no such database.
    """
    with closing(_opened(path)) as database:
        first, last = _bounds(database, path)
        begin, leap = first, LEAP
        while first <= last:
            taken: list[can.Message] = []
            row, problem = _take(database, first, taken, findings)
            if taken:
                yield from_messages(taken), min(1.0, (row - begin + 1) / (last - begin + 1))
            if not problem and row < first:
                return
            leap = LEAP if row >= first else 2 * leap
            first = max(row, first - 1) + 1
            if problem:
                findings.add(None, f"rows from here on are damaged ({problem}); going on {leap} rows later", first)
                first += leap


def fill(path: Path, batches: Iterable[Frames]) -> int:
    """Number of frames that were written into a new database; python-can's own writer drops some when it is stopped."""
    count = 0
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(TABLE)
        for batch in batches:
            database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", map(_row, batch.messages()))
            count += len(batch)
    return count


def _row(message: can.Message) -> tuple[float, int, bool, bool, bool, int, bytes]:
    return (
        message.timestamp,
        message.arbitration_id,
        message.is_extended_id,
        message.is_remote_frame,
        message.is_error_frame,
        message.dlc,
        bytes(message.data),
    )


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"file:{quote(str(path))}?mode=ro&immutable=1", uri=True)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def _bounds(database: sqlite3.Connection, path: Path) -> tuple[int, int]:
    """First and last row, in a table and no view: a view may compute without end."""
    try:
        kind = database.execute("SELECT type FROM sqlite_master WHERE name = 'messages'").fetchone()
        if kind is None or kind[0] != "table":
            raise TraceError(path, "has no table 'messages'", "give a database that python-can wrote")
        database.execute(ROWS, (0, 0))
        first = database.execute("SELECT min(rowid) FROM messages").fetchone()[0]
        last = database.execute("SELECT max(rowid) FROM messages").fetchone()[0]
    except (sqlite3.Error, UnicodeError) as problem:  # SQLite quotes what it does not understand
        raise TraceError(
            path, f"is no readable SQLite database of messages ({excerpt(problem)})", "record or export it again"
        ) from None
    return (1, 0) if first is None else (int(first), int(last))


def _take(database: sqlite3.Connection, first: int, taken: list[can.Message], findings: Findings) -> tuple[int, str]:
    """Number of the last row that was read, and what ended the reading before its time."""
    row = first - 1
    try:
        for row, *values in database.execute(ROWS, (first, BATCH)):
            message, problem = _message(values)
            if problem or message is None:
                findings.add(None, f"is no frame: {problem}", row)
            else:
                taken.append(message)
    except (sqlite3.Error, OverflowError, UnicodeError) as problem:
        return row, excerpt(problem)
    return row, ""


def _message(values: list[Any]) -> tuple[can.Message | None, str]:
    time, identifier, extended, remote, error, length, data = values
    numbers = all(isinstance(value, int) for value in (identifier, extended, remote, error, length))
    if not (numbers and isinstance(time, int | float) and isinstance(data, bytes | None)):
        return None, "a value of another type"
    message = can.Message(
        timestamp=time,
        arbitration_id=identifier,
        is_extended_id=bool(extended),
        is_remote_frame=bool(remote),
        is_error_frame=bool(error),
        is_fd=len(data or b"") > CLASSIC,
        dlc=length,
        data=data,
    )
    return message, oddity(message)
