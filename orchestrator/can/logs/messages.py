"""From python-can's messages, as its readers give them, to batches of frames; what no frame can be is found here."""

from __future__ import annotations

import logging
import math

import can

from orchestrator.can.frames import CLASSIC, LONGEST
from orchestrator.stamps import LATEST

BATCH = 1 << 14  # messages that are put into columns at once


def oddity(message: can.Message) -> str:
    """Why a message is no frame, "" where it is one."""
    return _odd_stamp(message.timestamp) or _odd_identifier(message) or _odd_data(message)


def _odd_stamp(stamp: object) -> str:
    if not (isinstance(stamp, int | float) and math.isfinite(stamp)):
        return "its time stamp is no number"
    return "" if abs(stamp) <= LATEST else f"its time stamp is {stamp:g}"


def _odd_identifier(message: can.Message) -> str:
    number = message.arbitration_id
    return "" if 0 <= number < (1 << 29 if message.is_extended_id else 1 << 11) else f"its identifier is {number:#x}"


def _odd_data(message: can.Message) -> str:
    there, told = len(message.data), message.dlc
    if there > (LONGEST if message.is_fd else CLASSIC):
        return f"it has {there} data bytes"
    if message.is_remote_frame:
        return "" if 0 <= told <= LONGEST else f"it asks for {told} data bytes"
    return "" if there in (told, min(told, CLASSIC)) else f"it says {told} data bytes and has {there}"


def silence() -> None:
    """Keep python-can's readers and writers from logging line by line what is counted here."""
    logging.getLogger("can.io").setLevel(logging.ERROR)
