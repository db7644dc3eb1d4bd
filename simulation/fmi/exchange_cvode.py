"""CVODE, from the SUNDIALS libraries that FMPy ships, made ready to be called by address."""

import ctypes
import weakref
from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from simulation.fmi.exchange_calls import SLOT, derivatives, indicators

try:
    from fmpy.sundials import libraries
except Exception as error:  # no libraries for this platform, or of another version
    raise InputError(
        f"model exchange needs the CVODE that comes with FMPy, and it cannot be loaded ({error}); "
        "export the FMU for co-simulation"
    ) from None

_BACKWARD_DIFFERENCES: Final = 2
_ADDRESS, _DOUBLE, _LONG, _INT = ctypes.c_void_p, ctypes.c_double, ctypes.c_int64, ctypes.c_int

# What CVODE's return flags mean to someone who calibrates.
FLAGS: Final = {
    -1: "the integrator needed too many steps (CV_TOO_MUCH_WORK)",
    -2: "the tolerance is tighter than the numbers' precision (CV_TOO_MUCH_ACC)",
    -3: "the integrator needed too small steps (CV_ERR_FAILURE)",
    -4: "the integrator's equations did not converge (CV_CONV_FAILURE)",
    -5: "the linear solver could not be initialized (CV_LINIT_FAIL)",
    -6: "the linear solver could not be set up (CV_LSETUP_FAIL)",
    -7: "the linear solver failed (CV_LSOLVE_FAIL)",
    -8: "the derivatives could not be calculated (CV_RHSFUNC_FAIL)",
    -9: "the derivatives could not be calculated at the start of a step (CV_FIRST_RHSFUNC_ERR)",
    -10: "the derivatives could not be calculated however small the step (CV_REPTD_RHSFUNC_ERR)",
    -11: "the derivatives could not be calculated (CV_UNREC_RHSFUNC_ERR)",
    -12: "the event indicators could not be calculated (CV_RTFUNC_FAIL)",
}


def flag_in_words(flag: int) -> str:
    """Say what a negative return flag of CVODE means.

    Args:
        flag: The flag.

    Returns:
        A clause without a subject before it or a full stop after it.
    """
    return FLAGS.get(flag, f"the integrator gave up (CVODE flag {flag})")


class Cvode:
    """A CVODE memory for n states (backward differences, Newton, dense); freed when it is forgotten.

    Attributes:
        x: States that CVODE reads at a restart and writes after a step. Shape (max(1, n),).
        x_between: States at a time inside the last step. Shape (max(1, n),).
        absolute: Absolute tolerances, read at each call of CVodeSVtolerances. Shape (max(1, n),).
    """

    def __init__(self, table: IntArray, *, relative_tolerance: float, longest_step_s: float) -> None:
        """Make a solver for the instance that a table describes, and enter its addresses there.

        Args:
            table: The table (see exchange_calls), component, functions and counts filled in. It is
                CVODE's user data and must stay where it is. Shape (SLOT.SIZE,).
            relative_tolerance: Relative tolerance.
            longest_step_s: No internal step is longer, so that an event indicator is looked at as often. [s]
        """
        # CVODE wants one state at least; a model without any is given one that rests.
        n = max(1, int(table[SLOT.N_STATES]))
        n_indicators = int(table[SLOT.N_INDICATORS])
        self.x: FloatArray = np.zeros(n)
        self.x_between: FloatArray = np.zeros(n)
        self.absolute: FloatArray = np.full(n, relative_tolerance)
        self._table = table
        core, cvode = libraries.sundials_core, libraries.sundials_cvode
        context = _ADDRESS()
        _check(_function(core, "SUNContext_Create", _INT, _ADDRESS)(0, ctypes.byref(context)))
        # Its messages would go to the terminal; the flags tell what happened.
        _check(_function(core, "SUNContext_ClearErrHandlers", _ADDRESS)(context))
        make_vector = _function(
            libraries.sundials_nvecserial, "N_VMake_Serial", _LONG, _ADDRESS, _ADDRESS, result=_ADDRESS
        )
        vectors = [
            make_vector(n, array.ctypes.data, context) for array in (self.x, self.x_between, self.absolute)
        ]
        make_matrix = _function(
            libraries.sundials_sunmatrixdense, "SUNDenseMatrix", _LONG, _LONG, _ADDRESS, result=_ADDRESS
        )
        matrix = make_matrix(n, n, context)
        make_solver = _function(
            libraries.sundials_sunlinsoldense,
            "SUNLinSol_Dense",
            _ADDRESS,
            _ADDRESS,
            _ADDRESS,
            result=_ADDRESS,
        )
        linear = make_solver(vectors[0], matrix, context)
        create = _function(cvode, "CVodeCreate", _INT, _ADDRESS, result=_ADDRESS)
        memory = create(_BACKWARD_DIFFERENCES, context)
        self._memory = memory

        def do(name: str, *arguments: tuple[Any, Any]) -> None:
            kinds = [kind for kind, _ in arguments]
            _check(_function(cvode, name, _ADDRESS, *kinds)(memory, *(value for _, value in arguments)))

        do("CVodeInit", (_ADDRESS, derivatives.address), (_DOUBLE, 0.0), (_ADDRESS, vectors[0]))
        do("CVodeSVtolerances", (_DOUBLE, relative_tolerance), (_ADDRESS, vectors[2]))
        do("CVodeSetUserData", (_ADDRESS, table.ctypes.data))
        do("CVodeSetLinearSolver", (_ADDRESS, linear), (_ADDRESS, matrix))
        if n_indicators:
            do("CVodeRootInit", (_INT, n_indicators), (_ADDRESS, indicators.address))
            do("CVodeSetNoInactiveRootWarn")
        do("CVodeSetMaxStep", (_DOUBLE, longest_step_s))
        do("CVodeSetMaxHnilWarns", (_INT, -1))
        weakref.finalize(self, _free, memory, linear, matrix, vectors, context.value or 0)
        table[SLOT.SOLVER] = memory
        table[SLOT.X], table[SLOT.X_BETWEEN], table[SLOT.ABSOLUTE] = vectors
        table[SLOT.VECTOR_DATA] = _address(core, "N_VGetArrayPointer")
        for slot, name in (
            (SLOT.SOLVE, "CVode"),
            (SLOT.RESTART, "CVodeReInit"),
            (SLOT.STOP_AT, "CVodeSetStopTime"),
            (SLOT.INTERPOLATE, "CVodeGetDky"),
            (SLOT.TOLERANCES, "CVodeSVtolerances"),
        ):
            table[slot] = _address(cvode, name)


def _free(memory: int, linear: int, matrix: int, vectors: list[int], context: int) -> None:
    core, cvode = libraries.sundials_core, libraries.sundials_cvode
    _function(cvode, "CVodeFree", _ADDRESS, result=None)(ctypes.byref(_ADDRESS(memory)))
    _function(core, "SUNLinSolFree", _ADDRESS)(linear)
    _function(core, "SUNMatDestroy", _ADDRESS, result=None)(matrix)
    for vector in vectors:
        _function(core, "N_VDestroy", _ADDRESS, result=None)(vector)
    _function(core, "SUNContext_Free", _ADDRESS)(ctypes.byref(_ADDRESS(context)))


def _function(library: Any, name: str, *arguments: Any, result: Any = _INT) -> Any:
    """Declare a C function anew: FMPy's own declarations are left alone."""
    return ctypes.CFUNCTYPE(result, *arguments)((name, library))


def _address(library: Any, name: str) -> int:
    return int(ctypes.cast(getattr(library, name), _ADDRESS).value or 0)


def _check(flag: int) -> None:
    if flag < 0:
        raise RuntimeError(f"CVODE cannot be set up: {flag_in_words(flag)}")
