"""Frames of python-can as operations, and back."""

from __future__ import annotations

import can

from orchestrator.can.ls_bus.operations import Transmit, TransmitFd


def operation_of(message: can.Message) -> Transmit | TransmitFd:
    """A frame of python-can as an operation."""
    who = message.arbitration_id, message.is_extended_id
    if message.is_fd:
        return TransmitFd(*who, message.bitrate_switch, message.error_state_indicator, bytes(message.data))
    return Transmit(*who, message.is_remote_frame, message.dlc, bytes(message.data))


def message_of(frame: Transmit | TransmitFd) -> can.Message:
    """An operation as a frame of python-can, without a stamp."""
    if isinstance(frame, TransmitFd):
        return can.Message(
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            is_fd=True,
            bitrate_switch=frame.switched,
            error_state_indicator=frame.error_state,
            data=frame.data,
        )
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        dlc=frame.length,
        data=frame.data,
    )
