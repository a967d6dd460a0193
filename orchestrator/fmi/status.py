"""What FMUs return, in words."""

from __future__ import annotations

STATUS = ("OK", "warning", "discard", "error", "fatal error", "pending")


def returned(status: int) -> str:
    """That a function returned this status."""
    return f"returned {STATUS[status] if 0 < status < len(STATUS) else status}"


def stepping(time: float, duration: float) -> str:
    """What an FMU is doing that steps from a time by a duration [s], for messages."""
    return f"step from t = {time:g} s by {duration:g} s"
