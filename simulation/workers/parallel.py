"""A forward model that lives in supervised worker processes: a crash, a hang or a leak costs one row."""

import logging
import os
import threading
import weakref
from collections.abc import Callable
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path

from simulation.errors import InputError
from simulation.workers.arena import Arena
from simulation.workers.campaign import Campaign
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.recipe import Facts, Recipe
from simulation.workers.spooled_model import SpooledModel
from simulation.workers.tally import Speed, Tally
from simulation.workers.workforce import Workforce

_LOG = logging.getLogger(__name__)


class ParallelModel(SpooledModel):
    """A model whose every row is simulated in a worker process, never in this one.

    Workers start with the first row, as many as the rows are worth, and stay until close(). The answer is the
    same, bit for bit, whoever simulates which row. Not for use from several threads at once.
    """

    def __init__(
        self,
        make_model: Recipe,
        n_workers: int | None = None,
        *,
        policy: ExecutionPolicy | None = None,
        spool: Path | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        """Start nothing yet.

        Args:
            make_model: Recipe for the model, see SpooledModel.
            n_workers: Most worker processes; None for one per core that this process may use.
            policy: What happens to rows that hang, crash or fail.
            spool: Folder in which finished rows survive the death of this process, see SpooledModel.
            on_warning: Told, in one line, what a user should know at once; None for the log.
        """
        if not callable(make_model):
            raise InputError(
                "processes need a recipe for the model, as case.make_model, not a "
                f"{type(make_model).__name__}"
            )
        if n_workers is not None and n_workers < 1:
            raise ValueError(f"n_workers is {n_workers}; at least one process has to work")
        super().__init__(make_model, policy=policy, spool=spool)
        self._n_workers = min(n_workers or available_cores(), self._policy.max_workers or 2**31)
        self._on_warning = on_warning or _LOG.warning
        self._workforce = Workforce(
            make_model, self._n_workers, policy=self._policy, on_warning=self._on_warning
        )
        self._speed = Speed()
        self._n_loads = 0
        self._finalizer = weakref.finalize(self, _abandon, self._workforce, self._kept)

    @property
    def n_workers(self) -> int:
        """Most worker processes that rows are spread over."""
        return self._n_workers

    @property
    def n_processes(self) -> int:
        """Worker processes that there are now."""
        return self._workforce.n_processes

    def _ask_for_facts(self) -> Facts:
        return self._workforce.open()

    def _work_off(self, arena: Arena, tally: Tally) -> None:
        self._n_loads += 1
        campaign = Campaign(
            arena,
            self._n_loads,
            self._workforce,
            policy=self._policy,
            tally=tally,
            speed=self._speed,
            on_warning=self._on_warning,
        )
        campaign.run()

    def _let_go(self, *, at_once: bool) -> None:
        self._workforce.close(at_once=at_once)


def _abandon(workforce: Workforce, arenas: list[Arena]) -> None:
    """End the workers of a forgotten model; rows that may not be stored stay in the spool."""
    workforce.close(at_once=True)
    for arena in arenas:
        arena.release()


def available_cores() -> int:
    """Count the cores that this process may use.

    Returns:
        At least 1.
    """
    return len(os.sched_getaffinity(0))


def exit_with_parent() -> None:
    """Make this process end at once when the process that started it ends, however that happens.

    For the first line of a worker of multiprocessing. Without it, workers of a killed parent go on for ever.
    """
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        # Not sys.exit: nothing here is worth finishing, and only the main thread could.
        os._exit(1)

    threading.Thread(target=watch, name="exit-with-parent", daemon=True).start()
