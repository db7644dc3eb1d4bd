"""Every row as if it were the first: how an FMU is started over, and what is believed about that."""

import math
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.instance import FmuInstance
from simulation.fmi.log import forget_messages
from simulation.fmi.runner import NeedsFreshProcess, Solver

Way = Literal["reset", "state"]

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
    even tried. A reset that is an error, or lies, is given up for setting a saved state (where the FMU can),
    and that for new instances. An FMU of which not even a new instance repeats the row gets a process for
    every row.

    Two FMUs cannot be given new instances before the proof, one that allows one instance per process and one
    whose rows share a warm-up: their second row is started over on trust and handed out after the proof.

    An FMU that keeps its first parameters for as long as its process lives repeats its first row well. It
    shows in a second row that answers other parameters with the same bits: that row goes to another process.
    What no run in one process can show is an FMU that keeps some of them; that takes the same row in two.
    """

    def __init__(
        self,
        instance: FmuInstance,
        solver: Solver,
        *,
        ways: tuple[Way, ...],
        trusting: bool = False,
        prepare: Callable[[], str] | None = None,
        n_ignored: int = 0,
    ) -> None:
        """Answer rows with an instance, by a solver.

        Args:
            instance: The FMU, just instantiated.
            solver: What takes it through one row.
            ways: How it may be started over, apart from a new instance; tried in this order.
            trusting: Whether the second row is started over before that is proven.
            prepare: What every new instance goes through before its first row; says why it failed.
            n_ignored: Outputs at the start of a row that are not compared.
        """
        self._instance = instance
        self._solver = solver
        self._ways = list(ways)
        self._trusting = trusting
        self._prepare = prepare
        self._n_ignored = n_ignored
        self._proven = False
        self._untouched = True
        self._prepared = False
        self._no_start = ""
        self._first: tuple[FloatArray, FloatArray] | None = None
        self._renewed_s = 0.0
        self._remembers = False

    @property
    def way(self) -> Way | Literal["undecided", "new instance", "new process"]:
        """How rows are started over, as far as that is settled."""
        if self._remembers:
            return "new process"
        if not self._proven:
            return "undecided"
        return self._ways[0] if self._ways else "new instance"

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
            return self._start_over() or self._solve(values, y)
        began = time.perf_counter()
        if failure := self._start_over():
            return failure
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
            if on_trust and not self._same(y, self._first[1]):
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
        self._instance.damaged = reason != "" or not math.isfinite(y[self._n_ignored :].sum())
        return reason

    def _start_over(self) -> str:
        """Make the instance as if just made; return why that failed, "" when it did not."""
        if not self._untouched:
            tried = bool(self._ways) and (self._proven or self._trusting) and not self._instance.damaged
            if not (tried and self._back(self._ways[0])):
                return self._renew()
        return "" if self._prepared else self._make_ready()

    def _renew(self) -> str:
        """Replace the instance by a new one."""
        self._prepared = False
        self._instance.replace()
        self._untouched = True
        return self._make_ready()

    def _make_ready(self) -> str:
        # It is the same for every row, and so is its failure.
        self._no_start = self._no_start or (self._prepare() if self._prepare is not None else "")
        self._prepared = not self._no_start
        if self._prepared and "state" in self._ways[:1]:
            self._instance.save_state()
        return self._no_start

    def _back(self, way: Way) -> bool:
        """Bring the instance back by one of the ways; return whether the FMU says that it is."""
        return self._instance.reset() if way == "reset" else self._instance.restore_state()

    def _prove(self, values: FloatArray, y: FloatArray) -> None:
        """Settle how rows are started over, just after the row of these values and outputs.

        Raises:
            NeedsFreshProcess: If a new instance does not repeat the first row either, or the row at hand has
                the first one's outputs: its parameters may never have arrived.
        """
        assert self._first is not None
        first_values, first_y = self._first
        if self._same(y, first_y):
            raise NeedsFreshProcess("the FMU answers other parameters like its first ones, to the last bit")
        again = np.empty_like(y)
        # A copy, as ways that fail are removed meanwhile.
        for way in list(self._ways):
            if self._back(way) and not self._solve(first_values, again) and self._same(again, first_y):
                break
            self._ways.remove(way)
            # On trust, the row at hand was answered by an instance that had not forgotten another.
            if self._ways and (self._renew() or self._solve(values, y if self._trusting else again)):
                self._ways = []
                break
        if not self._ways:
            failed = self._renew() or self._solve(first_values, again)
            # Not the same bits, and no absolute part: outputs may be of any size.
            if failed or not np.allclose(
                again[self._n_ignored :], first_y[self._n_ignored :], rtol=_SAME_ANSWER, atol=0.0
            ):
                self._remembers = True
                raise NeedsFreshProcess(
                    "a new instance of the FMU does not repeat the first row of its process"
                )
            if self._trusting and (reason := self._renew() or self._solve(values, y)):
                raise NeedsFreshProcess(f"a row failed once its FMU was new: {reason}")
        self._proven = True
        self._first = None

    def _same(self, y: FloatArray, other: FloatArray) -> bool:
        return np.array_equal(y[self._n_ignored :], other[self._n_ignored :])
