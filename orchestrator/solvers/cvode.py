"""CVODE of SUNDIALS, in the build that FMPy brings: BDF of variable order, with a dense Jacobian by differences.

It is called by addresses here, for FMPy's own class neither stops at given times nor frees what it allocates.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_char_p, c_double, c_int, c_int64, c_void_p
from typing import Any

import numpy as np
from fmpy.sundials import libraries

from orchestrator.solvers.base import Rates, Solver, SolverSettings
from orchestrator.trace import FloatArray

_LARGEST = 5000  # number of states; SUNDIALS does not look whether it was given memory
_BDF, _ONE_STEP = 2, 2
_NO_COMMUNICATOR = 0
_TRY_SMALLER, _GIVE_UP = 1, -1  # what a right-hand side says to CVODE
_RightHandSide = ctypes.CFUNCTYPE(c_int, c_double, c_void_p, c_void_p, c_void_p)
_ErrorHandler = ctypes.CFUNCTYPE(None, c_int, c_char_p, c_char_p, c_char_p, c_int, c_void_p, c_void_p)


def _function(library: ctypes.CDLL, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    return ctypes.CFUNCTYPE(result, *arguments)((name, library))


_core, _cvode = libraries.sundials_core, libraries.sundials_cvode
_context_create = _function(_core, "SUNContext_Create", c_int, c_int, c_void_p)
_context_free = _function(_core, "SUNContext_Free", c_int, c_void_p)
_clear_handlers = _function(_core, "SUNContext_ClearErrHandlers", c_int, c_void_p)
_push_handler = _function(_core, "SUNContext_PushErrHandler", c_int, c_void_p, _ErrorHandler, c_void_p)
_vector = _function(libraries.sundials_nvecserial, "N_VNew_Serial", c_void_p, c_int64, c_void_p)
_data = _function(_core, "N_VGetArrayPointer", c_void_p, c_void_p)
_vector_free = _function(_core, "N_VDestroy", None, c_void_p)
_matrix = _function(libraries.sundials_sunmatrixdense, "SUNDenseMatrix", c_void_p, c_int64, c_int64, c_void_p)
_matrix_free = _function(_core, "SUNMatDestroy", None, c_void_p)
_linear = _function(libraries.sundials_sunlinsoldense, "SUNLinSol_Dense", c_void_p, c_void_p, c_void_p, c_void_p)
_linear_free = _function(_core, "SUNLinSolFree", c_int, c_void_p)
_create = _function(_cvode, "CVodeCreate", c_void_p, c_int, c_void_p)
_free = _function(_cvode, "CVodeFree", None, c_void_p)
_initialise = _function(_cvode, "CVodeInit", c_int, c_void_p, _RightHandSide, c_double, c_void_p)
_initialise_again = _function(_cvode, "CVodeReInit", c_int, c_void_p, c_double, c_void_p)
_tolerances = _function(_cvode, "CVodeSVtolerances", c_int, c_void_p, c_double, c_void_p)
_use_linear = _function(_cvode, "CVodeSetLinearSolver", c_int, c_void_p, c_void_p, c_void_p)
_no_warnings = _function(_cvode, "CVodeSetMaxHnilWarns", c_int, c_void_p, c_int)
_stop_time = _function(_cvode, "CVodeSetStopTime", c_int, c_void_p, c_double)
_advance = _function(_cvode, "CVode", c_int, c_void_p, c_double, c_void_p, c_void_p, c_int)
_interpolate = _function(_cvode, "CVodeGetDky", c_int, c_void_p, c_double, c_int, c_void_p)


class Cvode(Solver):
    """CVODE; see `Solver`.

    Raises (on construction):
        MemoryError: too many states for a dense Jacobian.
    """

    def __init__(self, rates: Rates, size: int, settings: SolverSettings) -> None:
        if size > _LARGEST:
            raise MemoryError(f"a Jacobian of {size} by {size} numbers")
        super().__init__(rates, size, settings)
        self._message = ""
        self._raised: BaseException | None = None
        self._time, self._reached = 0.0, c_double()
        self._handlers = _RightHandSide(self._evaluate), _ErrorHandler(self._note)  # kept from being collected
        self._context = c_void_p()
        _context_create(_NO_COMMUNICATOR, ctypes.byref(self._context))
        _clear_handlers(self._context)
        _push_handler(self._context, self._handlers[1], None)
        self._arrays: dict[int, FloatArray] = {}
        self._x, self._absolutes = (_vector(size, self._context) for _ in range(2))
        self._states, self._limits = self._array(self._x), self._array(self._absolutes)
        self._states[:], self._limits[:] = 0.0, 1.0
        self._matrix = _matrix(size, size, self._context)
        self._linear = _linear(self._x, self._matrix, self._context)
        self._memory = c_void_p(_create(_BDF, self._context))
        self._require(_initialise(self._memory, self._handlers[0], 0.0, self._x))
        self._require(_tolerances(self._memory, settings.relative_tolerance, self._absolutes))
        self._require(_use_linear(self._memory, self._linear, self._matrix))
        self._require(_no_warnings(self._memory, -1))

    def restart(self, time: float, states: FloatArray, nominals: FloatArray) -> None:
        self._time = time
        self._states[:] = states
        self._limits[:] = self._absolute(nominals)
        self._require(_tolerances(self._memory, self._settings.relative_tolerance, self._absolutes))
        self._require(_initialise_again(self._memory, time, self._x))

    def step(self, limit: float) -> float:
        self._message = ""
        self._require(_stop_time(self._memory, limit))
        self._require(_advance(self._memory, limit, self._x, ctypes.byref(self._reached), _ONE_STEP))
        if not self._reached.value > self._time:
            raise ArithmeticError("its steps became too small")
        self._time = self._reached.value
        return self._time

    def at(self, time: float) -> FloatArray:
        self._require(_interpolate(self._memory, time, 0, self._x))
        return self._states

    def close(self) -> None:
        if self._memory:
            _free(ctypes.byref(self._memory))
            _linear_free(self._linear)
            _matrix_free(self._matrix)
            _vector_free(self._x)
            _vector_free(self._absolutes)
            _context_free(ctypes.byref(self._context))

    def _evaluate(self, time: float, states: int, rates: int, _: int | None) -> int:
        """The right-hand side. No exception passes through C, so it is kept."""
        try:
            result = self._rates(time, self._array(states))
            if not np.isfinite(result).all():
                return _TRY_SMALLER
            self._array(rates)[:] = result
        except BaseException as error:
            self._raised = error
            return _GIVE_UP
        return 0

    def _array(self, vector: int) -> FloatArray:
        """(n,) the memory of a vector of SUNDIALS."""
        address = _data(vector)
        if address not in self._arrays:
            self._arrays[address] = np.ctypeslib.as_array((c_double * self._size).from_address(address))
        return self._arrays[address]

    def _note(self, _line: int, _where: bytes, _file: bytes, message: bytes, *_: Any) -> None:
        self._message = " ".join(message.decode(errors="replace").split())

    def _require(self, status: int) -> None:
        """See that a function succeeded; what the right-hand side raised comes out here."""
        if status >= 0:
            return
        raised, self._raised = self._raised, None
        if raised is not None:
            raise raised
        raise ArithmeticError(self._message or f"CVODE returned {status}")
