"""What native FMUs say that they can, in the words of each version of FMI."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Capabilities:
    """Flags by their names in one version of FMI."""

    common: dict[str, bool]
    derivatives: tuple[str, ...]
    exchange: dict[str, bool]


CAPABILITIES = {
    2: Capabilities(
        dict.fromkeys(("canGetAndSetFMUstate", "canSerializeFMUstate", "canNotUseMemoryManagementFunctions"), True)
        | {"needsExecutionTool": False},
        ("providesDirectionalDerivative",),
        {"completedIntegratorStepNotNeeded": False},
    ),
    3: Capabilities(
        {"needsExecutionTool": False, "canGetAndSetFMUState": True, "canSerializeFMUState": True},
        ("providesDirectionalDerivatives", "providesAdjointDerivatives"),
        {"needsCompletedIntegratorStep": True},
    ),
}

# On a bus: what is on its way is no part of a state to go back to.
NETWORKED = Capabilities({"needsExecutionTool": False}, CAPABILITIES[3].derivatives, {})
