"""The formats of text: Vector's .asc, candump's .log, PEAK's .trc and python-can's .csv."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import can
from can.io import ASCReader, CanutilsLogReader, CSVReader, TRCReader

from fmus.errors import TraceError
from orchestrator.can.frames import CLASSIC
from orchestrator.can.log_suffixes import CSV_HEADER
from orchestrator.can.logs.text.reading import LineKind, TextFormat

ERROR_FLAG, IDENTIFIER = 0x20000000, 0x1FFFFFFF
NUMBER = re.compile(r"\d+$")

ASC_LONG_FRAME = 0x1000  # of a CANFD line's flags
ASC_HEADER = re.compile(r"(date|base|(?:no\s+)?internal\s+events|begin\s+triggerblock)\b", re.IGNORECASE)
ASC_NOTHING = re.compile(
    r"//|(date|base|(no\s+)?internal\s+events|begin\s+triggerblock|end\s+triggerblock|"
    r"previous\s+log\s+file|\d+\.\d+\s+start\s+of\s+measurement)\b",
    re.IGNORECASE,
)
ASC_PREAMBLE = re.compile(r"//|(date|base|(no\s+)?internal\s+events)\b", re.IGNORECASE)
ASC_FRAME = re.compile(r"\d+\.\d+\s+(\d+\s+[0-9a-f]+x?\s|canfd\b)", re.IGNORECASE)
ASC_EVENT = re.compile(r"\d+\.\d+\s+\S")
TRC_EVENT = re.compile(r"\d+\)?\s+\d+(\.\d+)?\s+(\d+\s+)?(Warng|Error|Status|ST|ER|EC|EV|ErrFr|FFFFFFFF)\b")


def _asc_reader(feed: Any) -> Iterable[can.Message]:
    return ASCReader(feed, relative_timestamp=False)


def _candump_reader(feed: Any) -> Iterable[can.Message]:
    return CanutilsLogReader(feed)


def _csv_reader(feed: Any) -> Iterable[can.Message]:
    return CSVReader(feed)


def _trc_reader(feed: Any) -> Iterable[can.Message]:
    return TRCReader(feed)


def _asc_header(line: str) -> str:
    found = ASC_HEADER.match(line)
    if found is None:
        return ""
    if found[1].lower() == "base" and "relative" in line.lower():
        raise TraceError("", "its stamps are relative to the event before", "export it with absolute stamps")
    return " ".join(found[1].lower().split()).removeprefix("no ")


def _asc_kind(line: str) -> LineKind:
    if ASC_NOTHING.match(line):
        return LineKind.NOTHING
    return LineKind.EVENT if ASC_EVENT.match(line) and not ASC_FRAME.match(line) else LineKind.BROKEN


def _asc(message: can.Message, line: str) -> None:
    """A CAN FD frame without data is one, though the reader takes it for a remote frame."""
    if not (message.is_fd and message.is_remote_frame):
        return
    told = line.split()
    bitrate_switch = 5 if told[5].isdigit() else 6  # behind a symbolic name
    if int(told[bitrate_switch + 6], 16) & ASC_LONG_FRAME:
        message.is_remote_frame = False


def _trc_header(line: str) -> str:
    name = line.partition("=")[0]
    return name if name in (";$FILEVERSION", ";$STARTTIME", ";$COLUMNS") else ""


def _trc_kind(line: str) -> LineKind:
    if line.startswith(";"):
        return LineKind.NOTHING
    return LineKind.EVENT if TRC_EVENT.match(line) else LineKind.BROKEN


def _broken(line: str) -> LineKind:
    return LineKind.BROKEN


def _long(message: can.Message, line: str) -> None:
    """A frame of more than eight bytes is one of CAN FD, which the format does not say."""
    message.is_fd = len(message.data) > CLASSIC


def _channel_from_1(message: can.Message, line: str) -> None:
    """PEAK counts its buses from 1; of a long frame the reader keeps the length's code."""
    if isinstance(message.channel, int):
        message.channel -= 1
    if not message.is_remote_frame:
        message.dlc = can.util.dlc2len(message.dlc)


def _candump(message: can.Message, line: str) -> None:
    """The number of the interface as channel, and every error frame, not only those of the bus."""
    _, interface, frame, *_ = line.split()
    number = NUMBER.search(interface)
    message.channel = int(number[0]) if number else 0
    identifier = int(frame.partition("#")[0], 16)
    if identifier & ERROR_FLAG and not message.is_error_frame:
        message.is_error_frame, message.arbitration_id = True, 0
        message.is_extended_id = True


def _never(line: str) -> str:
    return ""


def _csv_header(line: str) -> str:
    return CSV_HEADER if line == CSV_HEADER else ""


ASC = TextFormat(_asc_reader, _asc_header, _asc_kind, _asc, ASC_PREAMBLE, "internal events logged")
CANDUMP = TextFormat(_candump_reader, _never, _broken, _candump)
CSV = TextFormat(_csv_reader, _csv_header, _broken, _long)
TRC = TextFormat(_trc_reader, _trc_header, _trc_kind, _channel_from_1)
