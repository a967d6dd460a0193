"""How this process computes, which a library that is called in it can change for all; "fast" arithmetic does."""

from __future__ import annotations

import ctypes
import sys

_ONE, _LITTLE, _SMALLEST = 1.0, 2.0**-60, sys.float_info.min  # variables, so that it is the processor that computes


def altered() -> str:
    """What the processor does otherwise than IEEE 754 has it by default; "" where nothing is."""
    found = []
    if _SMALLEST / 2 == 0:
        found.append("takes numbers below 2.2e-308 for zero")
    if _ONE + _LITTLE != _ONE or _ONE - _LITTLE != _ONE:
        found.append("does not round to the nearest number")
    return " and ".join(found)


def set_back() -> bool:
    """Have the C library set this thread's arithmetic back; whether it is as it was."""
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "fesetenv"):
        libc.fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV
    return not altered()
