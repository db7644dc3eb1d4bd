"""The physical model of a study as its stages ask it: supervised, spread over processes, and never twice."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from simulation.case import Case
from simulation.experiments import JoinedModel
from simulation.forward_model import ForwardModel
from simulation.pool.execution import ExecutionPolicy, TooManyFailuresError
from simulation.pool.pool_model import PoolModel
from simulation.store.joined_store import JoinedStore, StoredExperiments
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from studies.calibration.experiments_ode import watched_model
from studies.calibration.states import watching_states
from studies.paths import ProjectPaths
from studies.stages.pipeline import StageError, Study
from studies.watched_model import StoredWatchedModel


def store_file(paths: ProjectPaths, case: Case) -> Path:
    """Return the file of a case's simulations; cases that simulate the same share it."""
    kind = "db" if case.layout is None else "json"
    return paths.generated(case.name) / "simulations" / f"{case.model_digest[:16]}.{kind}"


@contextmanager
def open_physical_model(
    study: Study, *, case: Case | None = None, policy: ExecutionPolicy | None = None
) -> Iterator[StoredModel]:
    """Open the model of a study's case with the store of its simulations.

    Args:
        study: the study.
        case: another case instead of the study's.
        policy: another patience instead of the case's.

    Yields:
        the model. Rows that are stored are not simulated; `unstored` asks it anew and keeps nothing.

    Raises:
        StageError: too many simulations fail; those that are finished are kept.
    """
    case = case or study.case
    with ExitStack() as opened:
        parts = case.experiments or (case,)
        stores = [opened.enter_context(_store(study, one)) for one in parts]
        model = opened.enter_context(_supervised(study, case, policy or case.policy))
        stored = StoredModel(model, stores[0], retry_failed=study.retry_failed)
        if case.layout is not None:
            store = JoinedStore(store_file(study.paths, case), stores, case.layout)
            store.save()
            joined = JoinedModel(model, case.experiment_rows, case.parameter_space)
            stored = StoredExperiments(joined, store, retry_failed=study.retry_failed)
        try:
            yield stored
        except TooManyFailuresError as stopped:
            raise StageError(f"{stopped}; the finished simulations are kept") from stopped


def _store(study: Study, case: Case) -> SimulationStore:
    """Open the store of a single experiment."""
    return SimulationStore(
        store_file(study.paths, case),
        model_digest=case.model_digest,
        parameter_names=case.parameter_space.names,
        output_names=case.settings.output_names,
        time=case.scenario.time,
    )


@contextmanager
def open_watched_model(study: Study, *, n_first: int = 1) -> Iterator[StoredWatchedModel]:
    """Open the model of a study's case with the stores of its simulations, with their states and without.

    Args:
        study: the study.
        n_first: rows that are asked at once while none has succeeded yet.

    Yields:
        the model.

    Raises:
        StageError: too many simulations fail; those that are finished are kept.
    """
    with (
        open_physical_model(study) as plain,
        open_physical_model(study, case=watching_states(study.case)) as watched,
    ):
        watching = watched_model(study.case, watched)
        yield StoredWatchedModel(plain, watched, watching, n_first=n_first)


def say_reused(study: Study, stage: str, model: StoredModel, *, n_repeated: int = 0) -> None:
    """Say how many of a stage's rows were simulated before.

    Args:
        study: the study.
        stage: what the stage is called.
        model: the model that was asked.
        n_repeated: rows that the stage asked for once more; they do not count again.
    """
    n_reused = model.n_reused - n_repeated
    if n_reused:
        study.console.say(f"{stage}: {n_reused} of {n_reused + model.n_simulated} simulations reused")


@contextmanager
def _supervised(study: Study, case: Case, policy: ExecutionPolicy) -> Iterator[ForwardModel]:
    """Open the model in processes of this machine, or of the cluster that was asked for."""
    warn = study.console.warn
    with ExitStack() as opened:
        executor = None
        if study.dask is not None:
            # Dask takes a second to import.
            from simulation.pool.dask_executor import DaskExecutor

            executor = opened.enter_context(DaskExecutor(study.dask))
        n_jobs = study.n_jobs if executor is None else None
        yield opened.enter_context(
            PoolModel(case.make_model, n_jobs, policy=policy, executor=executor, on_warning=warn)
        )
