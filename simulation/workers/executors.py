"""A forward model on any executor of concurrent.futures: threads, processes, or machines behind one."""

import logging
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from simulation.errors import InputError
from simulation.workers.arena import Arena, RowState
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.messages import Run
from simulation.workers.parallel import available_cores
from simulation.workers.piece import PieceAnswer, facts_of, parcel, parcel_with_files, simulate_piece
from simulation.workers.recipe import Facts, Recipe
from simulation.workers.remote_executor import RemoteExecutor
from simulation.workers.row_queue import RowQueue
from simulation.workers.spooled_model import SpooledModel
from simulation.workers.tally import Speed, Tally

_LOG = logging.getLogger(__name__)
# A piece this long hides what sending it costs; a process that is lost takes this much along, or one row.
_PIECE_S: Final = 1.0
_MIN_PIECE_S: Final = 0.1
_PIECE_BYTES: Final = 8_000_000
# A row that is lost so often with its process may be the reason.
_MAX_LOSSES: Final = 5


class ExecutorModel(SpooledModel):
    """A model whose rows are simulated in pieces on an executor, each in a supervised child process there.

    Not for use from several threads at once.
    """

    def __init__(
        self,
        make_model: Recipe,
        executor: Executor | Callable[[], Executor],
        *,
        n_slots: int | None = None,
        policy: ExecutionPolicy | None = None,
        spool: Path | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        """Submit nothing yet.

        Args:
            make_model: Recipe for the model, see SpooledModel.
            executor: The executor, which stays the caller's; or a function that makes one, which is called
                again when that breaks and closed with this model.
            n_slots: Pieces that it works on at a time; None to ask it where it knows, or for the cores that
                this process may use.
            policy: What happens to rows that hang, crash or fail; max_workers limits the pieces at a time.
            spool: Folder in which finished rows survive the death of this process, see SpooledModel.
            on_warning: Told, in one line, what a user should know at once; None for the log.
        """
        super().__init__(make_model, policy=policy, spool=spool)
        self._make_executor = None if isinstance(executor, Executor) else executor
        self._executor: Executor | None = executor if isinstance(executor, Executor) else None
        # How many may fail is a question to the campaign, not to a piece of it.
        self._piece_policy = replace(self._policy, max_failed_share=1.0)
        self._n_slots = n_slots
        self._on_warning = on_warning or _LOG.warning
        self._speed = Speed()
        self._files: dict[tuple[str, str], bytes] = {}
        if isinstance(executor, RemoteExecutor):
            self._parcel, self._files = parcel_with_files(make_model)
        else:
            self._parcel = parcel(make_model)

    def _ask_for_facts(self) -> Facts:
        facts: Facts = self._submit(facts_of).result()
        return facts

    def _work_off(self, arena: Arena, tally: Tally) -> None:
        queue = RowQueue(arena, run_s=_PIECE_S, min_run_s=_MIN_PIECE_S)
        flying: dict[Future[PieceAnswer], tuple[Run, Executor | None]] = {}
        losses: Counter[int] = Counter()
        try:
            while not tally.look_at(arena):
                slots = self._slots()
                while queue.n_waiting and len(flying) < 2 * slots:
                    run = queue.take(self._speed.row_s, slots, max_rows=_PIECE_BYTES // arena.grid.row_bytes)
                    try:
                        future = self._submit(simulate_piece, arena.theta[run.start : run.stop].copy())
                    except self._lost as error:
                        if self._make_executor is None:
                            raise
                        self._lose(arena, run, error, losses, self._executor)
                        queue.give_back(run)
                        break
                    flying[future] = run, self._executor
                for future in wait(flying, return_when=FIRST_COMPLETED).done:
                    run, executor = flying.pop(future)
                    try:
                        self._keep(arena, run, future.result())
                    except self._lost as error:
                        self._lose(arena, run, error, losses, executor)
                        queue.give_back(run)
        finally:
            for future in flying:
                future.cancel()

    def _keep(self, arena: Arena, run: Run, answer: PieceAnswer) -> None:
        self._speed.saw(len(answer.failures), answer.spent_s)
        arena.y[run.start : run.stop] = answer.y
        for row, reason in enumerate(answer.failures, start=run.start):
            if reason:
                arena.fail(row, reason)
            else:
                arena.states[row] = RowState.GOOD

    def _lose(
        self,
        arena: Arena,
        run: Run,
        error: BaseException,
        losses: Counter[int],
        executor: Executor | None,
    ) -> None:
        """Give the rows of a lost piece another chance, except those that were lost too often."""
        self._on_warning(
            f"a process of the executor was lost ({type(error).__name__}); the {run.stop - run.start} rows "
            "that it was given are simulated again"
        )
        for row in range(run.start, run.stop):
            losses[row] += 1
            if losses[row] > _MAX_LOSSES:
                arena.fail(row, f"the process that simulated it was lost {losses[row]} times")
        # One that broke tells so of every piece that it had, also when it has been replaced.
        if isinstance(error, BrokenExecutor) and executor is self._executor:
            self._let_go(at_once=True)

    @property
    def _lost(self) -> tuple[type[BaseException], ...]:
        special = self._executor.lost if isinstance(self._executor, RemoteExecutor) else ()
        return (BrokenExecutor, CancelledError, *special)

    def _slots(self) -> int:
        if self._n_slots is not None:
            slots = self._n_slots
        elif isinstance(self._executor, RemoteExecutor):
            slots = self._executor.n_slots
        else:
            slots = available_cores()
        return max(1, min(slots, self._policy.max_workers or slots))

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        if self._executor is None:
            assert self._make_executor is not None
            self._executor = self._make_executor()
        arguments = (self._parcel, self._piece_policy, *arguments)
        if not isinstance(self._executor, RemoteExecutor):
            return self._executor.submit(function, None, *arguments)
        for (digest, name), content in self._files.items():
            self._executor.send_file(digest, name, content)
        return self._executor.submit_with_files(function, *arguments)

    def _let_go(self, *, at_once: bool) -> None:
        if self._make_executor is not None and self._executor is not None:
            self._executor.shutdown(wait=not at_once, cancel_futures=True)
            self._executor = None


def dask_executor(address: str) -> Executor:
    """Connect to a Dask cluster.

    Args:
        address: The scheduler's, for instance tcp://scheduler:8786.

    Returns:
        An executor for ExecutorModel; its shutdown() disconnects.

    Raises:
        InputError: If Dask is not installed, or nobody answers there.
    """
    try:
        from simulation.workers.dask_cluster import DaskExecutor
    except ImportError:
        raise InputError(f"{address}: Dask is not installed; pip install 'pelsvae-studies[dask]'") from None
    return DaskExecutor(address)
