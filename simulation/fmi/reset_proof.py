"""Every row as if it were the first: how an FMU is started over, and what is believed about that."""

import math
import time
from typing import Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.log import forget_messages
from simulation.fmi.runner import NeedsFreshProcess, Solver
from simulation.fmi.status import Instance

# A row as quick as this is repeated without a thought.
_CHEAP_S = 0.1
# A second instance that differs by less has rounded differently; by more, it remembers something.
_SAME_ANSWER = 1e-6


class RestartingRunner:
    """Runs a solver row by row on one instance that is started over in between.

    A reset that says OK and yet leaves something behind would falsify rows without a sign, so none is
    believed unseen: until one is proven, every row gets a new instance. The proof repeats the first good row
    after another one and asks for the same bits; it takes one more row, once per process. It is made at the
    second row where rows are quick, and else as soon as new instances have cost as much time as a row, so
    that it never costs more than it saves: where a row takes an hour and an instance a second, resets are not
    even tried. A reset that is an error, or lies, is given up for new instances. An FMU of which not even a
    new instance repeats the row gets a process for every row.

    An FMU that allows one instance per process cannot be given new ones before the proof: its second row is
    started over on trust and handed out after the proof.

    An FMU that keeps its first parameters for as long as its process lives repeats its first row well. It
    shows in a second row that answers other parameters with the same bits: that row goes to another process.
    What no run in one process can show is an FMU that keeps some of them; that takes the same row in two.
    """

    def __init__(self, instance: Instance, solver: Solver, *, trusting: bool = False) -> None:
        """Answer rows with an instance, by a solver.

        Args:
            instance: The FMU, just instantiated.
            solver: What takes it through one row.
            trusting: Whether the second row is started over before that is proven.
        """
        self._instance = instance
        self._solver = solver
        self._resets = True
        self._trusting = trusting
        self._proven = False
        self._untouched = True
        self._first: tuple[FloatArray, FloatArray] | None = None
        self._renewed_s = 0.0
        self._remembers = False

    @property
    def way(self) -> Literal["undecided", "reset", "new instance", "new process"]:
        """How rows are started over, as far as that is settled."""
        if self._remembers:
            return "new process"
        if not self._proven:
            return "undecided"
        return "reset" if self._resets else "new instance"

    def run(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row as if it were the first.

        Args:
            values: The calibrated parameters. Shape (p,). [FMU's units]
            y: Filled with the outputs, contiguous. Shape (n_warmup + t, k). [FMU's units]

        Returns:
            Why the row failed, in one line; "" when it is good.

        Raises:
            NeedsFreshProcess: If only another process can answer this row.
        """
        if self._remembers:
            raise NeedsFreshProcess("the FMU remembers earlier rows for as long as its process lives")
        if self._proven:
            self._start_over()
            return self._solve(values, y)
        began = time.perf_counter()
        self._start_over()
        renewed = time.perf_counter()
        on_trust = not self._untouched
        reason = self._solve(values, y)
        took_s = time.perf_counter() - renewed
        self._renewed_s += renewed - began
        if self._instance.damaged:
            if on_trust:
                raise NeedsFreshProcess("a row failed before it was proven that the FMU can be started over")
            return reason
        if self._first is None:
            self._first = (values.copy(), y.copy())
        elif np.array_equal(values, self._first[0]):
            if on_trust and not np.array_equal(y, self._first[1]):
                raise NeedsFreshProcess("the FMU does not repeat its first row")
        elif on_trust or max(_CHEAP_S, self._renewed_s) >= took_s:
            self._prove(values, y)
        return ""

    def _solve(self, values: FloatArray, y: FloatArray) -> str:
        self._untouched = False
        forget_messages()
        reason = self._solver.solve(values, y)
        # Not every FMU can be started over out of an error, or out of numbers that are none.
        # One sum instead of a test of each value: NaN and infinity survive it.
        self._instance.damaged = reason != "" or not math.isfinite(y.sum())
        return reason

    def _start_over(self) -> None:
        """Make the instance as if just made."""
        if not self._untouched:
            is_tried = self._resets and (self._proven or self._trusting) and not self._instance.damaged
            if not (is_tried and self._instance.reset()):
                self._renew()

    def _renew(self) -> None:
        """Replace the instance by a new one."""
        self._instance.replace()
        self._untouched = True

    def _prove(self, values: FloatArray, y: FloatArray) -> None:
        """Settle how rows are started over, just after the row of these values and outputs.

        Raises:
            NeedsFreshProcess: If a new instance does not repeat the first row either, or the row at hand has
                the first one's outputs: its parameters may never have arrived.
        """
        assert self._first is not None
        first_values, first_y = self._first
        if np.array_equal(y, first_y):
            raise NeedsFreshProcess("the FMU answers other parameters like its first ones, to the last bit")
        again = np.empty_like(y)
        has_reset = self._instance.reset() and not self._solve(first_values, again)
        self._resets = has_reset and np.array_equal(again, first_y)
        if not self._resets:
            self._renew()
            failed = self._solve(first_values, again)
            # Not the same bits, and no absolute part: outputs may be of any size.
            if failed or not np.allclose(again, first_y, rtol=_SAME_ANSWER, atol=0.0):
                self._remembers = True
                raise NeedsFreshProcess(
                    "a new instance of the FMU does not repeat the first row of its process"
                )
            if self._trusting:
                # The row at hand was answered by an instance that had not forgotten another.
                self._renew()
                if reason := self._solve(values, y):
                    raise NeedsFreshProcess(f"a row failed once its FMU was new: {reason}")
        self._proven = True
        self._first = None
