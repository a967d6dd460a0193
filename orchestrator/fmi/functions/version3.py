"""What all instances of FMI 3.0 share."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

from orchestrator.fmi.functions.base import FmiFunctions, Logger, limits


class Version3(FmiFunctions):
    """What all instances of FMI 3.0 share."""

    prefix = "fmi3"
    state_name = "FMUState"
    types = {
        "Float64": ctypes.c_double,
        "Float32": ctypes.c_float,
        "Boolean": ctypes.c_bool,
        "String": ctypes.c_char_p,
        "Binary": ctypes.c_void_p,
        **{f"{u}Int{bits}": getattr(ctypes, f"c_{u.lower()}int{bits}") for bits in (8, 16, 32, 64) for u in ("", "U")},
    }

    def instantiate(self) -> None:
        self.fmu.instantiate(logMessage=receiver(self._log))
        self.handle.value = self.fmu.component

    def storage(self, kind: str) -> str:
        return "Int64" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return (number,)

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        return self.call("EnterInitializationMode", *limits(ctypes.c_bool, start, stop, tolerance))


def receiver(log: Logger) -> Callable[[int, int, bytes, bytes], None]:
    """What takes an FMU's messages and passes them on."""

    def receive(environment: int, status: int, category: bytes, message: bytes) -> None:
        log(status, *((text or b"").decode(errors="replace").strip() for text in (category, message)))

    return receive
