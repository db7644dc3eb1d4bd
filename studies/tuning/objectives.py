"""Studies of a user's objective: a function takes a trial, and returns a value or several."""

import inspect
import logging
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

from simulation.arrays import digest_of
from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened
from studies.paths import ProjectPaths
from studies.reporting.drawing import write_picture
from studies.reporting.figures_objective import objective_figure
from studies.results.objective import ObjectiveDeclaration, TunedObjective, values_of
from studies.results.provenance import file_digest
from studies.tracking.origin import environment
from studies.tracking.runs import RunStore
from studies.tracking.sending import begin_sending
from studies.tuning import attempts
from studies.tuning.live_trial import LiveTrial, Objective
from studies.tuning.objective_results import read_objective
from studies.tuning.sampler import make_pruner, make_sampler
from studies.tuning.side_by_side import Group, Part, opened_run, work_on
from studies.tuning.storage import storage_of, study_locked

_LOG = logging.getLogger(__name__)


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
    provenance: Mapping[str, Any],
    until_s: float | None = None,
    on_poll: Callable[[TunedObjective], None] = lambda now: None,
    on_warning: Callable[[str], None] = _LOG.warning,
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
        provenance: what makes its trials again, see `source_of`.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        on_poll: called with the study, about twice a second.
        on_warning: called with one line that a user should see.
        given: a trial that is made again: its "params" and "seed".

    Raises:
        InputError: the study cannot be run as declared, or the storage cannot be used.
        StageError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    make_sampler(spec.sampler, spec.seed)
    make_pruner(spec.pruner)
    try:
        objective = cloudpickle.dumps(ObjectiveTrials(function))
    except (TypeError, pickle.PicklingError) as error:
        raise InputError(
            f"the objective cannot be given to worker processes: {shortened(str(error))}"
        ) from None
    with storage_of(paths) as storage:
        for known in storage.get_all_studies():
            declared = known.user_attrs.get(attempts.DECLARATION)
            label = declared.get("label") if isinstance(declared, dict) else None
            if label == spec.label and not attempts.is_of_objective(declared):
                raise InputError(f"{spec.label} is a label of surrogates here; give another --name")
        runs = RunStore(paths)
        begin_sending(paths)
        with study_locked(storage, paths, spec.name):
            study = attempts.make_study(storage, spec, n_trials=n_trials)
            if given is not None:
                study.enqueue_trial(given["params"], user_attrs={attempts.SEED: given["seed"]})
        before = study.user_attrs.get(attempts.PROVENANCE, provenance)
        if before.get("source_sha256") != provenance["source_sha256"]:
            on_warning(f"{spec.name}: the file of its objective has changed; another --name begins anew")
        run_id = opened_run(study, runs, spec, n_trials, provenance)
        part = Part(spec, study, run_id, storage, paths, runs)
        part.give_back()
        work_on(
            [Group([part])],
            n_jobs=n_jobs,
            n_parallel=n_parallel,
            until_s=until_s,
            on_poll=lambda group: on_poll(read_objective(study)),
            on_over=lambda group: _close(runs, read_objective(study), run_id),
            objective=objective,
        )
        return read_objective(study)


def _close(runs: RunStore, found: TunedObjective, run_id: str) -> None:
    """Write what a study has come to on its run, with a picture, and end the run."""
    numbers = {f"n_{one}": float(found.count(one)) for one in ("complete", "pruned", "failed")}
    first = values_of(found.best[0]) if found.best else ()
    numbers |= {f"best/{name}": one for name, one in zip(found.spec.values, first, strict=False)}
    runs.log(run_id, metrics=numbers, tags={"best_trial": "".join(str(one.number) for one in found.best[:1])})
    best = {one.number for one in found.best}
    groups: dict[str, list[list[float]]] = {"not feasible": [], "others": [], "the best": []}
    for one in found.trials:
        if one.state.name == "COMPLETE":
            is_kept = all(value <= 0.0 for value in one.constraints.values())
            name = "the best" if one.number in best else "others" if is_kept else "not feasible"
            groups[name].append([one.number, *values_of(one)])
    if any(groups.values()):
        figure = objective_figure(f"Trials of {found.spec.name}", ("trial", *found.spec.values), groups)
        with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
            picture = write_picture(figure, Path(scratch) / "trials.svg", footnote=found.spec.label)
            runs.log_files(run_id, [picture], "figures")
    runs.end(run_id, "FINISHED")
