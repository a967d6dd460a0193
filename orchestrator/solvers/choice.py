"""The solver behind a name; its libraries are loaded when it is chosen."""

from __future__ import annotations

from fmus.errors import WiringError
from orchestrator.solvers.base import Solver, SolverMethod


def solver_type(method: SolverMethod, component: str) -> type[Solver]:
    """The solver of this name, for a component.

    Raises:
        WiringError: there is no such one on this platform.
    """
    if method is not SolverMethod.CVODE:
        from orchestrator.solvers.scipy import TYPES  # noqa: PLC0415 - loads slowly

        return TYPES[method]
    try:
        from orchestrator.solvers.cvode import Cvode  # noqa: PLC0415 - loads libraries
    except Exception as error:  # FMPy raises its own kind where the version does not fit
        raise WiringError(
            f"{component}.solver", f"CVODE cannot be loaded ({error})", "use `method: BDF` or `Radau`"
        ) from error
    return Cvode
