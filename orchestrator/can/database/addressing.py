"""Identifiers of which a part says what a frame is, and another who sends it: those of J1939 and of CANopen."""

from __future__ import annotations

from dataclasses import dataclass

ANY = 0xFE  # J1939's null address: no sender has it, so that a message with it is that of any


@dataclass(frozen=True)
class Addressing:
    """How identifiers of a message are matched.

    Attributes:
        kind: "J1939" or "CANopen".
        mask: bits that say what the frame is.
        sender: bits with the address of its sender.
    """

    kind: str
    mask: int
    sender: int

    def label(self, address: int) -> str:
        """What its sender is called."""
        return f"sa{address:02x}" if self.kind == "J1939" else f"node{address}"


CANOPEN = Addressing("CANopen", 0x780, 0x7F)


def j1939(identifier: int) -> Addressing:
    """Of the group (PGN) of this identifier, whatever priority, sender and receiver are (SAE J1939-21, 5.2)."""
    to_one = identifier >> 16 & 0xFF < 240
    return Addressing("J1939", 0x03FF0000 if to_one else 0x03FFFF00, 0xFF)
