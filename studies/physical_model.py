"""The physical model of a study as its stages ask it: supervised, spread over processes, and never twice.

With state equations its states are read, too: `StoredWatchedModel`.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import isfinite
from pathlib import Path

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.errors import OutOfTimeError, ReuseError
from simulation.experiments import JoinedModel
from simulation.forward_model import ForwardModel
from simulation.pool.execution import ExecutionPolicy, TooManyFailuresError
from simulation.pool.pool_model import PoolModel
from simulation.store.joined_store import JoinedStore, StoredExperiments
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories
from studies.calibration.state_equations.experiments_ode import watched_model
from studies.calibration.state_equations.states import (
    StateSignals,
    WatchedModel,
    watching_states,
    why_unwatched,
)
from studies.paths import ProjectPaths
from studies.results.outcome import read_manifest
from studies.simulation_time import Timed, note_time
from studies.task import StageError, Task

TIME_OVER = "--max-hours ended it; the finished simulations are kept, and the same command goes on"


def store_file(paths: ProjectPaths, case: Case) -> Path:
    """Return the file of a case's simulations; cases that simulate the same share it."""
    kind = "db" if case.layout is None else "json"
    return paths.generated(case.name) / "simulations" / f"{case.model_digest[:16]}.{kind}"


@contextmanager
def open_physical_model(
    task: Task, *, case: Case | None = None, policy: ExecutionPolicy | None = None
) -> Iterator[StoredModel]:
    """Open the model of a study's case with the store of its simulations.

    Args:
        task: the task.
        case: another case instead of the study's.
        policy: another patience instead of the case's.

    Yields:
        the model. Rows that are stored are not simulated; `unstored` asks it anew and keeps nothing.

    Raises:
        StageError: too many simulations fail, or --max-hours is over; those that are finished are kept.
        ReuseError: simulations of one process depended on each other; those that may be wrong are removed,
            with the results that came from them.
    """
    case = case or task.case
    with ExitStack() as opened:
        stores = list[SimulationStore]()
        for one in case.experiments or (case,):
            part = SimulationStore(
                store_file(task.paths, one),
                model_digest=one.model_digest,
                parameter_names=one.parameter_space.names,
                output_names=one.settings.output_names,
                time=one.scenario.time,
            )
            stores.append(opened.enter_context(part))
            if never_reused_file(task.paths, one).is_file() and not part.is_reuse_given_up:
                part.give_up_reuse()
        n_jobs, executor = task.n_jobs, None
        if task.dask is not None:
            # Dask takes a second to import.
            from simulation.pool.dask_executor import DaskExecutor

            n_jobs, executor = None, opened.enter_context(DaskExecutor(task.dask))
        policy, warn = policy or case.policy, task.console.warn
        pool = PoolModel(case.make_model, n_jobs, policy=policy, executor=executor, on_warning=warn)
        model = opened.enter_context(pool)
        # So few simulations that none has to be repeated to prove that it forgets the one before.
        model.always_new = task.profile.is_budgeted
        model.begins_until_s = task.until_s
        stored = StoredModel(model, stores[0], retry_failed=task.retry_failed)
        if case.layout is not None:
            store = JoinedStore(store_file(task.paths, case), stores, case.layout)
            store.save()
            joined = JoinedModel(model, case.experiment_rows, case.parameter_space)
            stored = StoredExperiments(joined, store, retry_failed=task.retry_failed)
        try:
            yield stored
        except TooManyFailuresError as stopped:
            raise StageError(f"{stopped}; the finished simulations are kept") from stopped
        except OutOfTimeError as over:
            raise StageError(TIME_OVER) from over
        except ReuseError:
            give_up_reuse(task)
            raise
        finally:
            if case is task.case:
                opening_s = model.opening_s if isfinite(model.opening_s) else 0.0
                n, simulation_s = max(len(case.experiments), 1), model.simulation_s or 0.0
                note_time(task.paths, case, Timed(n * simulation_s, n * opening_s))


def never_reused_file(paths: ProjectPaths, case: Case) -> Path:
    """Return the file that says of a case's FMU that each simulation needs a process of its own."""
    simulations = paths.generated(case.name) / "simulations"
    return simulations / f"{case.fmu.sha256[:16]}.own-process"


def checked_file(paths: ProjectPaths, case: Case) -> Path:
    """Return the file that names the simulations that a check made of a case."""
    return paths.generated(case.name) / "simulations" / f"{case.model_digest[:16]}.checked.npz"


def give_up_reuse(task: Task) -> None:
    """Remember that a case's FMU does not forget a simulation, and remove what may be wrong by that.

    Removed are the stored simulations of the case that came after others in a process, also of its watched
    states and its validation period, and the finished stages of this case file.

    Args:
        task: the case.
    """
    case = task.case
    family = [case] if case.validation is None else [case, case.validation]
    family += [watching_states(one) for one in family if not why_unwatched(one)]
    for one in [member for joined in family for member in joined.experiments or (joined,)]:
        never = never_reused_file(task.paths, one)
        never.parent.mkdir(parents=True, exist_ok=True)
        never.touch()
        if (file := store_file(task.paths, one)).is_file():
            with SimulationStore.at(file) as store:
                store.give_up_reuse()
    recorded = task.paths.recorded(case.path)
    for manifest in task.results.parent.glob("*/*.json"):
        if (read_manifest(manifest.parent, manifest.stem) or {}).get("case_file") == recorded:
            manifest.unlink()


@contextmanager
def open_watched_model(task: Task, *, n_first: int = 1) -> Iterator["StoredWatchedModel"]:
    """Open the model of a study's case with the stores of its simulations, with their states and without.

    Args:
        task: the task.
        n_first: rows that are asked at once while none has succeeded yet.

    Yields:
        the model.

    Raises:
        StageError: too many simulations fail; those that are finished are kept.
    """
    with (
        open_physical_model(task) as plain,
        open_physical_model(task, case=watching_states(task.case)) as watched,
    ):
        watching = watched_model(task.case, watched)
        yield StoredWatchedModel(plain, watched, watching, n_first=n_first)


def say_reused(task: Task, stage: str, model: StoredModel, *, n_repeated: int = 0) -> None:
    """Say how many of a stage's rows were simulated before.

    Args:
        task: the task.
        stage: what the stage is called.
        model: the model that was asked.
        n_repeated: rows that the stage asked for once more; they do not count again.
    """
    if n_reused := model.n_reused - n_repeated:
        task.console.say(f"{stage}: {n_reused} of {n_reused + model.n_simulated} simulations reused")


N_UNREAD = 2
"""Rows that fail with their states and not without before states are left alone: one may have bad luck."""


class StoredWatchedModel(StoredModel):
    """A stored model whose new rows are asked of another one that watches the same model's states.

    Rows lie in both stores: with their states in the other one's, and without, for all other stages, in its
    own. An FMU may declare states and yet fail where they are read; then rows are asked without from there
    on.

    Attributes:
        watching: What remembers the states.
    """

    def __init__(
        self,
        plain: StoredModel,
        watched: StoredModel,
        signals: StateSignals | WatchedModel,
        *,
        n_first: int = 1,
    ) -> None:
        """Wrap two models.

        Args:
            plain: Answers without states.
            watched: Answers with them, see `studies.calibration.state_equations.states.watching_states`.
            signals: What is known of them, or the model that remembers them.
            n_first: Rows that are asked at once while none has succeeded yet.
        """
        self.watching = signals if isinstance(signals, WatchedModel) else WatchedModel(watched, signals)
        # What it looks like is asked of the model that answers: the other one may never be needed.
        super().__init__(self.watching, plain.store)
        self.unstored = plain.unstored
        self._plain, self._rows = plain, watched
        self._n_first = n_first
        self._are_read = False
        self._n_unread = 0

    def watched(self, theta: FloatArray) -> BoolArray:
        """Say which rows are stored with their states, failed ones left out.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        return self._rows.store.find_good(theta)

    def known(self, theta: FloatArray, watched: BoolArray) -> Trajectories:
        """Read rows that are stored, some with their states; what has got lost is simulated again.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            watched: Which of them have states. Shape (n,).

        Returns:
            The same as the model answers, bit for bit.
        """
        self.watching.forget()
        if watched.any():
            self._with_states(theta[watched])
            self._are_read = True
        return self._counted(self._without_states(theta))

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are stored with their states and simulate the others.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The same as the model answers without states, bit for bit.
        """
        theta = np.array(theta, dtype=np.float64)
        parts, n_done = [], 0
        self.watching.forget()
        while n_done < len(theta) and not (self._are_read or self.why_unread):
            parts.append(self._tried(theta[n_done : n_done + self._n_first]))
            n_done += parts[-1].n
        if n_done < len(theta) or not parts:
            ask = self._plain.simulate if self.why_unread else self._with_states
            parts.append(ask(theta[n_done:]))
        return self._counted(Trajectories.concatenate(parts))

    def _tried(self, theta: FloatArray) -> Trajectories:
        """Ask rows with their states, and without where that fails: it may be the states that fail."""
        answer = self._with_states(theta)
        if self.watched(theta).any():
            # An output beyond its band makes its row a failed one, and the states were read all the same.
            self._are_read = True
            return answer
        plain = self._without_states(theta)
        self.n_asked_twice += len(theta)
        self._n_unread += int((~plain.failed).sum())
        if self._n_unread >= N_UNREAD:
            self.why_unread = answer.failures[int(np.argmin(plain.failed))]
        return plain

    def _with_states(self, theta: FloatArray) -> Trajectories:
        answer = self.watching.simulate_more(theta)
        # What fails where states are read need not fail without.
        is_better = ~self.store.find(theta) | (~self.store.find_good(theta) & ~answer.failed)
        taken = self.watched(theta) & is_better
        self.store.append(answer.take(taken), self._rows.store.first(theta[taken]))
        return answer

    @property
    def simulation_s(self) -> float | None:
        """Time of a simulation with its states, or without, None where nothing was simulated yet. [s]."""
        return self._rows.simulation_s or self._plain.simulation_s

    def repeats(self, theta: FloatArray) -> bool:
        """Repeat a stored row, with its states if it has them, see `StoredModel.repeats`."""
        asked = self._rows if self.watched(theta[None])[0] else self._plain
        does = asked.repeats(theta)
        self.reuse = asked.reuse
        return does

    def _without_states(self, theta: FloatArray) -> Trajectories:
        # One after the other: there may be a licence for one of them.
        _end_processes(self._rows.unstored)
        answer = self._plain.simulate(theta)
        _end_processes(self._plain.unstored)
        return answer

    def _counted(self, answer: Trajectories) -> Trajectories:
        self.n_simulated = self._plain.n_simulated + self._rows.n_simulated
        self.n_reused = self._plain.n_reused + self._rows.n_reused
        self.failures += filter(None, answer.failures)
        return answer


def _end_processes(model: ForwardModel) -> None:
    """End what simulates for a model; work starts it again."""
    if isinstance(model, PoolModel):
        model.close()
