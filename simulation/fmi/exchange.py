"""Model exchange: the FMU gives derivatives and events, the solver is the CVODE that FMPy ships."""

import ctypes
import weakref
from functools import cache
from typing import Any

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from simulation.fmi import exchange_calls as calls
from simulation.fmi import exchange_loop as loop
from simulation.fmi.call import make_ready
from simulation.fmi.description import FmuDescription
from simulation.fmi.instance import FmuInstance
from simulation.fmi.row_calls import RunPlan
from simulation.fmi.start import Start

try:
    from fmpy import sundials
    from fmpy.sundials import cvode, libraries
except Exception as error:  # no libraries for this platform, or of another version
    raise InputError(
        f"model exchange needs the CVODE that comes with FMPy, and it cannot be loaded ({error}); "
        "export the FMU for co-simulation"
    ) from None

# OpenModelica's default, used where neither case nor FMU names a tolerance.
DEFAULT_TOLERANCE = 1e-6
# CVODE bounds the error of one step, and many steps add up. With a tenth of the tolerance the office stays
# within the tolerance of its exact solution: 3e-4 K of 300 K at 1e-6.
SHARE_OF_TOLERANCE = 0.1
_Pointer = ctypes.c_void_p

# What CVODE's return flags mean to someone who calibrates.
FLAGS = {
    -2: "the tolerance is tighter than the numbers' precision (CV_TOO_MUCH_ACC)",
    -3: "the integrator needed too small steps (CV_ERR_FAILURE)",
    -4: "the integrator's equations did not converge (CV_CONV_FAILURE)",
    -6: "the linear solver could not be set up (CV_LSETUP_FAIL)",
    -8: "the derivatives could not be calculated (CV_RHSFUNC_FAIL)",
    -9: "the derivatives could not be calculated at the start of a step (CV_FIRST_RHSFUNC_ERR)",
    -10: "the derivatives could not be calculated however small the step (CV_REPTD_RHSFUNC_ERR)",
    -11: "the derivatives could not be calculated (CV_UNREC_RHSFUNC_ERR)",
    -12: "the event indicators could not be calculated (CV_RTFUNC_FAIL)",
}


@cache
def prepare() -> None:
    """Compile the loop, for whatever FMU, once in a process."""
    table, places = np.zeros((0, 6), dtype=np.intp), np.zeros(0, dtype=np.int64)
    references, values = np.zeros(0, dtype=np.uint32), np.zeros(0)
    y = np.zeros((0, 0))
    make_ready(loop.simulate_row, places, table, table, places, references, values, 1, 1.0, (values,) * 3, y)


class ModelExchange:
    """A Solver of model-exchange FMUs of FMI 2.0 and 3.0."""

    def __init__(
        self, instance: FmuInstance, plan: RunPlan, start: Start, *, description: FmuDescription
    ) -> None:
        """Look up the functions and set up CVODE.

        Args:
            instance: The FMU.
            plan: What is set, stepped through and read.
            start: Sets the parameters and initializes.
            description: What the FMU says of itself.

        Raises:
            InputError: If the FMU's binary lacks a function, or a state is an array.
        """
        for name in description.states:
            # Of a size that a parameter says; others are states of their own, element by element.
            if description.variables[name].shape:
                raise InputError(
                    f"{description.path}: state {name} is an array, which model exchange cannot integrate; "
                    "export the FMU for co-simulation"
                )
        self._instance = instance
        self._plan = plan
        self._start = start
        self._states = description.states
        self._names = (*calls.FUNCTIONS, *(one.function for one in (*start.inputs, *start.seen)))
        self._tolerance = SHARE_OF_TOLERANCE * (
            # What an FMU suggests is not checked before, and may be 0.
            plan.tolerance if plan.tolerance is not None and plan.tolerance > 0.0 else DEFAULT_TOLERANCE
        )
        self._table: IntArray = np.zeros(calls.SIZE, dtype=np.int64)
        self._table[: len(calls.FUNCTIONS)] = instance.addresses(*calls.FUNCTIONS)
        self._table[calls.N_STATES] = len(description.states)
        self._table[calls.N_INDICATORS] = description.n_event_indicators
        self._cvode = Cvode(
            self._table,
            relative_tolerance=self._tolerance,
            # Roots are sought at the ends of internal steps: a pair of events in a longer one is not seen.
            longest_step=float(np.max(np.diff(plan.edges))),
        )
        # CVODE starts anew only where an input changes: its first steps are short and of first order.
        inputs = plan.scenario.inputs
        is_change = np.any(inputs[1:] != inputs[:-1], axis=1)
        self._changes = np.append(1 + np.flatnonzero(is_change), plan.n_steps)
        # Before the first row, whose time may be limited: compiling takes seconds where nothing is cached.
        prepare()

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        if failure := self._start.begin(values):
            return failure
        self._table[calls.COMPONENT] = self._instance.component
        end, time = loop.simulate_row(*self._arguments(y))
        return "" if end == loop.GOOD else self._reason(end, self._plan.in_seconds(time))

    def _arguments(self, y: FloatArray) -> tuple[Any, ...]:
        """Return what the loop is called with."""
        plan = self._plan
        return (
            self._table,
            self._start.input_table,
            self._start.seen_table,
            self._changes,
            plan.output_references,
            plan.edges,
            plan.scenario.output_every,
            self._tolerance,
            self._cvode.vectors,
            y,
        )

    def _reason(self, end: int, time: float) -> str:
        """Return in one line why a simulation ended (see exchange_loop) at a time. [s]."""
        at, bad = f"at {time:g} s", int(self._table[calls.NOT_FINITE]) - 1
        failed = fault = ""
        if status := int(self._table[calls.STATUS]):
            failed = self._instance.failure(self._names[int(self._table[calls.STAGE])], status, time)
            fault = f"; {failed}"
        elif bad >= 0:
            fault = f"; the derivative of {self._states[bad]} is not finite"
        if end < 0:
            return f"{flag_in_words(end)} {at}{fault}"
        in_one = f"in one communication step {at}"
        return {
            loop.BAD_CALL: failed,
            loop.TOO_MANY_STEPS: f"the integrator needed more than {loop.MOST_STEPS} steps {in_one}{fault}",
            loop.TOO_MANY_EVENTS: f"the model had more than {loop.MOST_EVENTS} events {in_one}",
            loop.ENDED: f"the FMU asked to end the simulation {at}",
            loop.ENDLESS_ITERATION: f"the model's event did not settle "
            f"in {loop.MOST_ITERATIONS} iterations {at}",
            loop.BAD_STATE: f"state {self._states[bad] if bad >= 0 else ''} is not finite {at}",
            loop.STUCK: f"the integrator's steps became too small to get on {at}{fault}",
        }[end]


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

    def __init__(self, table: IntArray, *, relative_tolerance: float, longest_step: float) -> None:
        """Make a solver for the instance that a table describes, and enter its addresses there.

        Args:
            table: The table (see exchange_calls), functions and counts filled in. It is CVODE's user data
                and must stay where it is. Shape (SIZE,).
            relative_tolerance: Relative tolerance.
            longest_step: No internal step is longer, so that an event indicator is looked at as often. [FMU's
                unit of time]
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
        _check(cvode.CVodeSetMaxStep(memory, longest_step))
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
