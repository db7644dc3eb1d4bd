"""CVODE, from the SUNDIALS libraries that FMPy ships, made ready to be called by address."""

import ctypes
import weakref
from typing import Any

import numpy as np

from simulation.arrays import IntArray
from simulation.errors import InputError
from simulation.fmi import exchange_calls as calls

try:
    from fmpy import sundials
    from fmpy.sundials import cvode, libraries
except Exception as error:  # no libraries for this platform, or of another version
    raise InputError(
        f"model exchange needs the CVODE that comes with FMPy, and it cannot be loaded ({error}); "
        "export the FMU for co-simulation"
    ) from None

_Pointer = ctypes.c_void_p

# What CVODE's return flags mean to someone who calibrates.
FLAGS = {
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
    """Return the meaning of a negative return flag of CVODE, as a clause."""
    return FLAGS.get(flag, f"the integrator gave up (CVODE flag {flag})")


class Cvode:
    """A CVODE memory for n states (backward differences, Newton, dense); freed when it is forgotten.

    Attributes:
        vectors: States that CVODE reads at a restart and writes after a step, states at a time inside the
            last step, absolute tolerances that are read at each call of CVodeSVtolerances. Each of shape
            (max(1, n),).
    """

    def __init__(self, table: IntArray, *, relative_tolerance: float, longest_step_s: float) -> None:
        """Make a solver for the instance that a table describes, and enter its addresses there.

        Args:
            table: The table (see exchange_calls), functions and counts filled in. It is CVODE's user data
                and must stay where it is. Shape (SIZE,).
            relative_tolerance: Relative tolerance.
            longest_step_s: No internal step is longer, so that an event indicator is looked at as often. [s]
        """
        # CVODE wants one state at least; a model without any is given one that rests.
        n, n_indicators = max(1, int(table[calls.N_STATES])), int(table[calls.N_INDICATORS])
        context, core = _Pointer(), libraries.sundials_core
        _check(sundials.SUNContext_Create(0, ctypes.byref(context)))
        # Its messages would go to the terminal; the flags show what happened.
        _check(core.SUNContext_ClearErrHandlers(context))
        vectors = [sundials.N_VNew_Serial(n, context) for _ in range(3)]
        self.vectors = tuple(np.ctypeslib.as_array(sundials.NV_DATA_S(one), (n,)) for one in vectors)
        for values, at_first in zip(self.vectors, (0.0, 0.0, relative_tolerance), strict=True):
            values[:] = at_first
        matrix = _Pointer(sundials.SUNDenseMatrix(n, n, context))
        linear = _Pointer(sundials.SUNLinSol_Dense(vectors[0], matrix, context))
        # Backward differences, as for stiff models: explicit steps would follow the fastest time constant.
        memory = _Pointer(cvode.CVodeCreate(cvode.CV_BDF, context))
        right_hand_side = cvode.CVRhsFn(calls.derivatives.address)
        # Time and states are those of no simulation yet: every row begins with a restart.
        _check(cvode.CVodeInit(memory, right_hand_side, 0.0, vectors[0]))
        _check(cvode.CVodeSVtolerances(memory, relative_tolerance, vectors[2]))
        _check(libraries.sundials_cvode.CVodeSetUserData(memory, _Pointer(table.ctypes.data)))
        _check(sundials.CVodeSetLinearSolver(memory, linear, matrix))
        if n_indicators:
            _check(cvode.CVodeRootInit(memory, n_indicators, cvode.CVRootFn(calls.indicators.address)))
            _check(cvode.CVodeSetNoInactiveRootWarn(memory))
        _check(cvode.CVodeSetMaxStep(memory, longest_step_s))
        # No warnings that a step does not move the time: the loop counts such steps itself.
        _check(libraries.sundials_cvode.CVodeSetMaxHnilWarns(memory, -1))
        # What it frees, without self: a reference to self would let it live for ever.
        weakref.finalize(self, _free, memory, linear, matrix, vectors, context)
        # CVODE has its bare address, so the table must live as long.
        self._table = table
        names = ("CVode", "CVodeReInit", "CVodeSetStopTime", "CVodeGetDky", "CVodeSVtolerances")
        functions = [getattr(libraries.sundials_cvode, name) for name in names]
        addresses = [ctypes.cast(one, _Pointer).value or 0 for one in (*functions, memory, *vectors)]
        table[calls.SOLVE : calls.SIZE] = addresses


def _free(memory: Any, linear: Any, matrix: Any, vectors: list[Any], context: Any) -> None:
    core = libraries.sundials_core
    cvode.CVodeFree(ctypes.byref(memory))
    core.SUNLinSolFree(linear)
    core.SUNMatDestroy(matrix)
    for vector in vectors:
        core.N_VDestroy(vector)
    # Last: everything above was made in it.
    core.SUNContext_Free(ctypes.byref(context))


def _check(flag: int) -> None:
    if flag < 0:
        raise RuntimeError(f"CVODE cannot be set up: {flag_in_words(flag)}")
