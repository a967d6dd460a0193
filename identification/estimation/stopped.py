"""An estimation that was stopped, by an interrupt or because FMUs failed: it carries what it had found until then."""

from __future__ import annotations

from typing import Any

from fmus.errors import FmuError, PartialError


class EstimationInterrupted(KeyboardInterrupt):
    """An interrupt came; `result` is what had been found until then, of the type that there would have been."""

    def __init__(self, result: Any) -> None:
        super().__init__("interrupted")
        self.result = result


class EstimationFailed(PartialError):  # noqa: N818 - as what interrupts it
    """FMUs failed beyond what is tolerated; `result` as there."""

    result: Any


STOPPED = (EstimationInterrupted, EstimationFailed)


def stopped(error: KeyboardInterrupt | FmuError, result: Any) -> EstimationInterrupted | EstimationFailed:
    """What to raise instead of the error, with the result."""
    return EstimationFailed(error, result) if isinstance(error, FmuError) else EstimationInterrupted(result)


def reason(error: KeyboardInterrupt | FmuError) -> str:
    """Why it was stopped, for people."""
    return str(error) if isinstance(error, FmuError) else "interrupted"
