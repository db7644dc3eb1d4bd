"""Studies of a user's objective: a function takes a trial, and returns a value or several."""

import inspect
import pickle
import random
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
from optuna.trial import FrozenTrial

from simulation.arrays import digest_of
from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened
from studies.paths import ProjectPaths
from studies.reporting.drawing import write_picture
from studies.reporting.figures_objective import objective_figure
from studies.results.objective import ObjectiveDeclaration, TunedObjective
from studies.results.provenance import file_digest
from studies.tracking.origin import environment
from studies.tracking.runs import RunStore
from studies.tracking.sending import begin_sending
from studies.tuning import attempts
from studies.tuning.live_trial import LiveTrial, Objective
from studies.tuning.objective_results import read_objective
from studies.tuning.side_by_side import Group, Part, opened_run, work_on
from studies.tuning.storage import storage_of, study_locked
from studies.tuning.stored_trials import stored_trials

OnTrials = Callable[[Sequence[FrozenTrial]], None]
OnLine = Callable[[str], None]


def imported(address: str) -> Objective:
    """Return the function that `module:function` names, which a user typed; no file may name one.

    Raises:
        InputError: there is no such function.
    """
    module, _, name = address.partition(":")
    remedy = "give --objective MODULE:FUNCTION, a function of a module that Python can import here"
    try:
        found = getattr(import_module(module), name, None) if module and name else None
    except Exception as error:  # of the module's own lines, too
        said = shortened(next(iter(str(error).splitlines()), ""))
        raise InputError(f"{quoted(module)} cannot be imported: {type(error).__name__}: {said}") from error
    if not callable(found):
        raise InputError(f"{quoted(address)} is no function; {remedy}")
    return found


@dataclass(frozen=True)
class ObjectiveTrials:
    """What a trial of a user's study does: it calls the user's function.

    Attributes:
        function: the function.
    """

    function: Objective

    def __call__(self, trial: LiveTrial) -> float | Sequence[float]:
        """Call the function, with random numbers of the trial's own."""
        run = trial.begin({"seed": trial.seed})
        # Workers are forks of one process: without a seed they would all draw the same.
        random.seed(trial.seed)
        np.random.seed(trial.seed)  # noqa: NPY002 (of whoever draws from it)
        try:
            return self.function(trial)
        finally:
            run.write({"params": trial.params, "seed": trial.seed, "environment": environment()})


def pickled(function: Objective) -> bytes:
    """Return an objective as workers get it from their command.

    Raises:
        InputError: it holds what no other process can have.
    """
    try:
        return cloudpickle.dumps(ObjectiveTrials(function))
    except (TypeError, pickle.PicklingError) as error:
        said = shortened(str(error))
        raise InputError(f"the objective cannot be handed to worker processes ({said})") from None


def source_of(function: Objective) -> dict[str, str]:
    """Return what an objective is called, and a digest of its text ("" where there is none)."""
    while hasattr(function, "func"):  # of functools.partial
        function = function.func
    named: Any = function if hasattr(function, "__qualname__") else type(function)
    try:
        file = Path(inspect.getsourcefile(named) or "")
        digest = file_digest(file) if file.is_file() else digest_of(inspect.getsource(named))
    except (OSError, TypeError):
        digest = ""
    return {"objective": f"{named.__module__}:{named.__qualname__}", "source_sha256": digest}


def tune_objective(
    spec: ObjectiveDeclaration,
    function: Objective,
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int,
    n_parallel: int,
    until_s: float | None,
    provenance: Mapping[str, Any],
    on_trials: OnTrials,
    on_warning: OnLine,
    given: Mapping[str, Any] | None = None,
) -> TunedObjective:
    """Bring a study to its trials, as `tune_studies.tune` does those of surrogates.

    Args:
        spec: the study.
        function: its objective.
        paths: the project.
        n_trials: trials in total, those of earlier commands among them.
        n_jobs: worker processes.
        n_parallel: workers of the study.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        provenance: what makes its trials again, see `source_of`.
        on_trials: called with the trials, about twice a second.
        on_warning: called with one line that a user should see.
        given: a trial that is made again: its "params" and "seed".

    Raises:
        InputError: the study cannot be run as declared, or the storage cannot be used.
        StageError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    objective = pickled(function)
    with storage_of(paths) as storage:
        for known in storage.get_all_studies():
            declared = known.user_attrs.get(attempts.DECLARATION) or {}
            if declared.get("label") == spec.label and not attempts.is_of_objective(declared):
                raise InputError(f"{spec.label} is a label of surrogates here; give another --name")
        runs = RunStore(paths)
        begin_sending(paths)
        with study_locked(storage, paths, spec.name):
            study = attempts.make_study(storage, spec, n_trials=n_trials)
            if given is not None:
                study.enqueue_trial(given["params"], user_attrs={attempts.SEED: given["seed"]})
        before = study.user_attrs.get(attempts.PROVENANCE, provenance)
        if before.get("source_sha256") != provenance["source_sha256"]:
            on_warning(f"{spec.name}: the file of its objective changed; another --name begins anew")
        run_id = opened_run(study, runs, spec, n_trials, provenance)
        part = Part(spec, study, run_id, storage, paths, runs)
        part.give_back()

        def close(group: Group[Part]) -> None:
            _close(runs, read_objective(study, stored_trials(storage, study._study_id)), run_id)

        work_on(
            [Group([part])],
            n_jobs=n_jobs,
            n_parallel=n_parallel,
            until_s=until_s,
            on_poll=lambda group: on_trials(part.trials),
            on_over=close,
            objective=objective,
        )
        return read_objective(study, stored_trials(storage, study._study_id))


def _close(runs: RunStore, found: TunedObjective, run_id: str) -> None:
    """Write what a study has come to on its run, with a picture, and end the run."""
    numbers: dict[str, float] = {f"n_{one}": found.count(one) for one in ("complete", "pruned", "failed")}
    numbers["n_best"] = len(found.best)
    if found.best:
        numbers |= {f"best/{name}": value for name, value in found.best[0].values.items()}
    runs.log(run_id, metrics=numbers, tags={"best_trial": found.best[0].number if found.best else ""})
    if (figure := objective_figure(found)) is not None:
        with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
            picture = write_picture(figure, Path(scratch) / "trials.svg", footnote=found.spec.label)
            runs.log_files(run_id, [picture], "figures")
    runs.end(run_id, "FINISHED")
