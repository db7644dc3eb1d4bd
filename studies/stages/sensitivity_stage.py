"""The stage that estimates Sobol indices: of the best surrogate, or of the physical model itself."""

import math

from simulation.errors import InputError
from studies.calibration.sobol import SobolIndices, sobol_indices, with_error_of_surrogate
from studies.physical_model import open_physical_model, say_reused
from studies.results.declaration import UNEXPLAINED
from studies.results.outcome import Outcome
from studies.simulation_time import duration
from studies.stages.calibrate_stage import best_surrogate, tuned_with_best
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_sensitivity
from studies.surrogate_model import SurrogateModel
from studies.task import Task

# Of a surrogate, which costs no simulation: enough that the sample's error is the smaller one.
N_BASE = 1024
# Values that it predicts for them at most, 0.8 GB; of longer outputs fewer base samples are taken.
MOST_VALUES = 100_000_000


def sensitivity_stage(task: Task) -> Outcome[SobolIndices]:
    """Estimate the Sobol indices, of what the profile says.

    Raises:
        InputError: that is a surrogate, and none is tuned yet.
    """
    if task.profile.sensitivity.model == "fmu":
        return fmu_sensitivity_stage(task)
    try:
        best = tuned_with_best(task, None)
    except InputError as error:
        raise InputError(f"{error}; or ask the FMU: studies sensitivity {task.command} --fmu") from error
    by_error = {n: math.inf if one.value is None else one.value for n, one in best.items()}
    return surrogate_sensitivity_stage(task, min(by_error, key=by_error.__getitem__))


def fmu_sensitivity_stage(task: Task) -> Outcome[SobolIndices]:
    """Estimate the Sobol indices of the physical model, by simulations."""
    budget = task.profile.sensitivity
    n_rows = budget.n_base * (task.case.parameter_space.n_parameters + 2)
    inputs = {
        "case": task.case.digest,
        "n_base": budget.n_base,
        "n_resamples": budget.n_resamples,
        "seed": task.profile.seed,
    }
    stage = Stage(
        task,
        "sensitivity",
        f"Sobol indices from {n_rows} simulations{duration(task, n_rows)}",
        inputs,
        SobolIndices,
        {"kind": "sensitivity"},
    )

    def estimate() -> SobolIndices:
        with open_physical_model(task) as model, task.console.progress("simulations", n_rows) as advance:
            indices = sobol_indices(
                model,
                n_base=budget.n_base,
                seed=task.profile.seed,
                n_resamples=budget.n_resamples,
                on_progress=advance,
            )
        say_reused(task, "sensitivity", model)
        if not task.paths.tracking_database.is_file():
            task.console.say("sensitivity: making MLflow's store, once")
        return indices

    return stage.once(estimate, log=log_sensitivity)


def surrogate_sensitivity_stage(task: Task, n_train: int) -> Outcome[SobolIndices]:
    """Estimate the Sobol indices of the best surrogate of a size, which costs no simulation."""
    best = tuned_with_best(task, [n_train])[n_train]
    unexplained = best.metrics.get(f"{best.spec.judged_by}{UNEXPLAINED}")
    if unexplained is None:
        raise InputError(
            f"trial {best.number} of {best.spec.name} was made by a version that did not note how much its "
            f"surrogate leaves unexplained; tune again, or type: studies sensitivity {task.command} --fmu"
        )
    budget, n_base = task.profile.sensitivity, _n_base(task)
    inputs = {
        "case": task.case.digest,
        "surrogate": best.weights_sha256,
        "n_base": n_base,
        "n_resamples": budget.n_resamples,
        "seed": task.profile.seed,
    }
    what = f"Sobol indices of the best surrogate, n_train = {n_train}"
    made = {"kind": "sensitivity", "n_train": n_train, "surrogate_run": best.run_id}
    stage = Stage(task, "sensitivity", what, inputs, SobolIndices, made)

    def estimate() -> SobolIndices:
        case = task.case
        model = SurrogateModel(
            best_surrogate(task, n_train),
            case.parameter_space,
            case.measurement.output_names,
            case.measurement.time,
            n_jobs=task.n_jobs,
        )
        found = sobol_indices(model, n_base=n_base, seed=task.profile.seed, n_resamples=budget.n_resamples)
        return with_error_of_surrogate(found, n_train, unexplained)

    return stage.once(estimate, log=log_sensitivity)


def _n_base(task: Task) -> int:
    """Return how many base samples a surrogate of a case is asked, a power of two."""
    measurement = task.case.measurement
    n_values = len(measurement.time) * len(measurement.output_names)
    most = MOST_VALUES // (n_values * (task.case.parameter_space.n_parameters + 2))
    return int(min(N_BASE, 1 << max(most, 2).bit_length() - 1))
