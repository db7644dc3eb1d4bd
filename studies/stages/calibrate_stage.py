"""The stage that calibrates by the paper's method: from the best surrogate of a training-set size."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pelsvae.device import n_threads_set
from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.surrogate import Surrogate
from simulation.errors import InputError
from simulation.store.stored_model import StoredModel
from studies.calibration.optimizers import Optimizer, SurrogateSearch, optimizer_of
from studies.calibration.problem import CalibrationProblem
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.search.row_choice import best_and_far
from studies.calibration.two_phase import calibrate_two_phase
from studies.own_surrogate import OwnSurrogate
from studies.paths import size_name
from studies.physical_model import open_physical_model, say_reused
from studies.profile import Profile
from studies.results.outcome import Outcome, digest_of
from studies.results.stage_results import Calibration, Screened
from studies.results.trials import TrialView
from studies.simulation_time import duration
from studies.stages.calibrated_point import calibration_at, repeat_best, validation_inputs
from studies.stages.knowledge import case_inputs, prior_of
from studies.stages.pipeline import Stage
from studies.stages.simulate_stage import train_design
from studies.stages.stage_runs import log_calibration
from studies.stages.tuned_trials import tuned_by_size
from studies.stages.warm_start import ChooseRows, StartRows, WarmStart, Worth
from studies.surrogate_model import SurrogateModel
from studies.task import Task
from studies.tracking.runs import load_surrogate, run_store
from studies.words.wording import count

# Rows that a polish begins with: processes of hundreds would think longer than they help.
chosen_rows = partial(best_and_far, n_best=80, n_far=20)
PHASES = {
    "screen": "screen, surrogate evaluations",
    "polish": "polish, FMU calls",
    "adaptive": "polish, FMU calls",
}


def tuned_with_best(task: Task, asked: Sequence[int] | None) -> dict[int, TrialView]:
    """Return the best trial of each training-set size.

    Args:
        task: the task.
        asked: the sizes the user named, None for all that have a surrogate of this case.

    Raises:
        InputError: an asked size has no surrogate, or there is none at all.
    """
    found = {n: one.best for n, one in tuned_by_size(task).items() if one.best is not None}
    missing = [n_train for n_train in asked or () if n_train not in found]
    if missing or not found:
        of, sizes = task.label, "".join(f" {n_train}" for n_train in missing)
        there = f"there are {', '.join(map(str, found))}" if found else "there are none"
        raise InputError(
            f"{of} has no surrogate of this case{f' for n_train ={sizes}' if sizes else ''}, {there}; "
            f"type: studies tune {task.command}{f' --n-train{sizes}' if sizes else ''}"
        )
    return {n: found[n] for n in sorted(set(asked or found))}


def best_surrogate(task: Task, n_train: int) -> Surrogate | MeanSurrogate | OwnSurrogate:
    """Load the best surrogate of a size from its MLflow run, on the CPU wherever it was trained.

    Raises:
        InputError: there is none of this case, or its weights cannot be read here.
    """
    best = tuned_with_best(task, [n_train])[n_train]
    return load_surrogate(run_store(task.paths), best.run_id)


def polisher(profile: Profile) -> Optimizer:
    """Return the optimizer that a profile polishes with.

    Raises:
        InputError: There is no such optimizer, or it has no such argument.
    """
    budget = profile.polish
    return optimizer_of(budget.optimizer, max_calls=budget.max_calls, ftol=budget.ftol)


def calibrate_stage(task: Task, n_train: int, *, again: bool = False) -> Outcome[Calibration]:
    """Calibrate with the stored surrogate of one training-set size.

    Args:
        task: the task.
        n_train: training-set size.
        again: calibrate though it is finished.
    """
    profile, best = task.profile, tuned_with_best(task, [n_train])[n_train]
    inputs = {
        **case_inputs(task.case),
        "surrogate": best.weights_sha256,
        "screening": asdict(profile.screening),
        "polish": profile.polish.settings,
        **{f"n_{name}": profile.data.sets.get(name, 0) for name in ("validation", "test")},
        "seed": profile.seed,
        **validation_inputs(task.case),
    }
    polisher(profile)  # a wrong name is said before hours of work
    name = profile.polish.optimizer["name"]
    polish = {"LeastSquaresTRF": "LS-TRF", "SurrogateSearch": "a search that it leads"}.get(name, name)
    n = profile.polish.max_calls
    what = f"differential evolution on the surrogate, then {polish} on the FMU, "
    what += f"{count(n, 'simulation')} at most{duration(task, n)}"
    made = {"kind": "calibration", "n_train": n_train, "surrogate_run": best.run_id}
    stage = Stage(task, f"calibrate-{size_name(n_train)}", what, inputs, Calibration, made)
    origin = {
        "study": best.spec.name,
        "trial": best.number,
        "model": best.model,
        "run_id": best.run_id,
        "params": dict(best.params),
        "errors": dict(best.metrics),
        "weights_sha256": best.weights_sha256,
    }
    start, files = None, list[Path]()
    if profile.is_budgeted:
        # All that is stored is paid for: training rows, those of smaller sizes, and of other commands.
        files = [stage.file.with_name(f"{stage.name}-rows.npz")]
        start = WarmStart(files[0], digest_of(inputs), chosen_rows, anew=again and stage.is_anew)
    return stage.once(
        lambda: calibrate(task, best_surrogate(task, n_train), n_train, origin, start),
        again=again,
        files=files,
        log=log_calibration,
    )


def _of_training(task: Task, n_train: int) -> ChooseRows:
    """Return what chooses among the training rows."""

    def choose(physical: StoredModel, problem: CalibrationProblem, worth: Worth) -> StartRows:
        theta = train_design(task, n_train)
        u = problem.space.to_unit(theta)
        theta = theta[chosen_rows(u, worth(problem.judge(u, physical.simulate(theta))))]
        return StartRows(theta, np.zeros(len(theta), dtype=np.bool_))

    return choose


def calibrate(
    task: Task,
    surrogate: Surrogate | MeanSurrogate | OwnSurrogate,
    n_train: int,
    origin: Mapping[str, Any] | None = None,
    start: ChooseRows | None = None,
) -> Calibration:
    """Calibrate and keep nothing but the simulations.

    Args:
        task: the task.
        surrogate: what the box is screened with.
        n_train: size of its training set.
        origin: of which trial it is, by the fields `SURROGATE_FIELDS` of `Screened`; None leaves it open.
        start: which stored rows a search that the surrogate leads begins with; None for training rows.
    """
    case, profile = task.case, task.profile
    measurement, space = case.measurement, case.parameter_space
    # Each of thousands of predictions would set the threads, which takes as long as the prediction.
    with (
        n_threads_set(surrogate.n_threads),
        open_physical_model(task) as physical,
        task.console.bars() as bars,
    ):
        polishing, rows, known, n_read = polisher(profile), None, None, 0
        if isinstance(polishing, SurrogateSearch):
            problem = CalibrationProblem(physical, measurement, prior_of(case), case.layout)
            rows = (start or _of_training(task, n_train))(physical, problem, lambda found: -found.objective)
            known = rows.judged(physical, problem)
            # What failed in training was said then.
            n_read, physical.failures = physical.n_reused, []
        result = calibrate_two_phase(
            SurrogateModel(surrogate, space, measurement.output_names, measurement.time, n_jobs=task.n_jobs),
            physical,
            measurement,
            screening=DifferentialEvolution(**asdict(profile.screening)),
            polishing=polishing,
            seed=profile.seed,
            n_train=n_train,
            n_validation=profile.data.sets.get("validation", 0),
            n_test=profile.data.sets.get("test", 0),
            prior=prior_of(case),
            layout=case.layout,
            rows=known,
            on_progress=lambda now: bars(PHASES[now.phase], now.n_done, now.n_total or now.n_done),
        )
        repeated = repeat_best(physical, result.polish.theta, result.ledger.total_paper)
    say_reused(task, f"calibrate-{size_name(n_train)}", physical, n_repeated=n_read)
    screened = result.screened
    return calibration_at(
        task,
        physical,
        result.polish,
        repeated=repeated,
        ledger=result.ledger,
        history=result.history,
        method="paper",
        n_train=n_train,
        settings={
            **{f"screening.{name}": value for name, value in asdict(profile.screening).items()},
            **{f"polish.{name}": value for name, value in profile.polish.settings.items()},
        },
        screening=Screened(
            theta=space.named(screened.theta[0]),
            mse_surrogate=result.mse_surrogate,
            mse=float(screened.mse[0]),
            stop_reason=result.screen.stop_reason,
            **(origin or {}),
        ),
        y_screened=screened.y[0],
        start_theta=None if rows is None else rows.theta,
        start_watched=None if rows is None else rows.watched,
    )
