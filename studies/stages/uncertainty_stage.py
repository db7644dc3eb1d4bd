"""The stage that says how sure a calibration is: identifiability, intervals, a posterior sample, bands.

Every simulated row is stored as it comes, and the rows follow from the calibration, the settings, the seed
and the list of stored rows that was written when the stage first began: interrupted, it goes on.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from simulation.errors import InputError
from simulation.store.stored_model import StoredModel
from studies.calibration.problem import CalibrationProblem
from studies.calibration.uncertainty.assess import STEP, Assessment, assess, particles_for, sampling_within
from studies.calibration.uncertainty.bands import bands_of, noise_of_outputs, share_within
from studies.calibration.uncertainty.findings import LEVEL, compensations, knowledge
from studies.calibration.uncertainty.noise import NoiseKind
from studies.calibration.uncertainty.rows import informative_rows
from studies.physical_model import say_reused
from studies.results.outcome import Outcome
from studies.results.stage_results import (
    ADAPTIVE,
    Calibration,
    Cost,
    Covered,
    Known,
    SampleFound,
    Uncertainty,
)
from studies.simulation_time import duration
from studies.stages.finished import stored_calibrations
from studies.stages.judged_model import judged_model
from studies.stages.knowledge import case_inputs, sensor_inputs
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_uncertainty
from studies.stages.warm_start import WarmStart
from studies.task import StageError, Task
from studies.words.wording import count, listed

LEAST_BUDGET, BUDGET_PER_PARAMETER = 100, 20
"""Most calls unless others are asked for; a sample that is good earlier ends earlier."""

TRUSTED = 0.3
"""A sample that is worth less than this share of its size is not to be relied upon."""


def usual_calls(n_parameters: int) -> int:
    """Return how many rows may be asked of the model unless the user says otherwise."""
    return max(LEAST_BUDGET, BUDGET_PER_PARAMETER * n_parameters)


def calibration_to_judge(task: Task, method: str | None, sizes: Sequence[int] | None) -> Outcome[Calibration]:
    """Return the calibration that was asked for: the adaptive one, else the best of the paper's.

    Args:
        task: The study.
        method: "paper" or "adaptive", None for either.
        sizes: Training-set sizes that were named, at most one; None for any.

    Raises:
        InputError: There is none.
    """
    if sizes and (method == ADAPTIVE or len(sizes) > 1):
        raise InputError("--n-train names one calibration of --method paper; give one size, or leave it away")
    every = list(stored_calibrations(task))
    fitting = [
        one
        for one in every
        if math.isfinite(one.result.mse)
        and (not sizes or one.result.n_train == sizes[0])
        and method in (None, one.result.method)
    ]
    if fitting:
        return min(fitting, key=lambda one: (not one.result.is_adaptive, one.result.mse))
    how = f" --n-train {sizes[0]}" if sizes else f" --method {method}" if method else ""
    there = listed(one.name for one in every) or "none of this window, measurement, scale and prior"
    raise InputError(
        f"{task.label} has no calibration{how and f' of{how}'}, there is {there}; type: studies calibrate "
        f"{task.command}{how}"
    )


def uncertainty_stage(
    task: Task,
    calibration: Outcome[Calibration],
    *,
    noise: NoiseKind,
    max_calls: int,
    again: bool = False,
) -> Outcome[Uncertainty]:
    """Say how sure a stored calibration is.

    Args:
        task: The study.
        calibration: The calibration.
        noise: Model of the noise.
        max_calls: Most rows that may be asked of the model.
        again: Do it though it is finished.
    """
    case, name = task.case, calibration.name
    inputs = {
        **case_inputs(case),
        "theta": calibration.result.theta,
        "settings": {"noise": noise, "max_calls": max_calls},
        "sampling": asdict(sampling_within(max_calls, case.parameter_space.n_parameters)),
        "step": STEP,
        "seed": task.profile.seed,
        **sensor_inputs(case),
        **({"state_equations": True} if calibration.result.believes_equations else {}),
    }
    what = f"differences and a posterior sample, {count(max_calls, 'simulation')} at most"
    what += duration(task, max_calls)
    stage = Stage(task, f"uncertainty-{name}", what, inputs, Uncertainty, {"kind": "uncertainty"})
    start = WarmStart(stage.file.with_name(f"{stage.name}-rows.npz"), stage.digest, informative_rows)
    return stage.once(
        lambda: _judge(task, calibration, start, noise, max_calls),
        again=again,
        files=[start.file],
        log=log_uncertainty,
    )


def _judge(
    task: Task, calibration: Outcome[Calibration], start: WarmStart, kind: NoiseKind, max_calls: int
) -> Uncertainty:
    """Say how sure a calibrated point is, and keep nothing but the simulations."""
    theta, n_parameters = calibration.result.point, task.case.parameter_space.n_parameters
    with judged_model(task, calibration, start, kind) as judged, task.console.bars() as bars:
        problem, physical, emulator = judged.problem, judged.physical, judged.emulator
        sampling = sampling_within(max_calls, n_parameters)
        if emulator is not None:
            sampling = replace(sampling, n_of_emulator=particles_for(emulator.n_operations))
        found = assess(
            problem,
            theta,
            judged.y,
            noise=judged.noise,
            known=judged.known,
            sampling=sampling,
            seed=task.profile.seed,
            emulator=emulator,
            on_phase=bars,
        )
    if not np.isfinite(found.sample.drawn.mse).any():
        raise StageError(f"no simulation of the sample succeeded; type: studies check {task.command}")
    # The point is asked first, to know the noise, and then among the stored rows once more.
    n_repeated = int(np.all(judged.rows.theta == theta, axis=1).sum())
    say_reused(task, f"uncertainty-{calibration.name}", physical, n_repeated=n_repeated)
    n_known, seed = len(judged.rows.theta), task.profile.seed
    return _result(problem, found, physical, n_known, calibration.name, seed, max_calls)


def _result(
    problem: CalibrationProblem,
    assessed: Assessment,
    physical: StoredModel,
    n_warm_start: int,
    calibration: str,
    seed: int,
    max_calls: int,
) -> Uncertainty:
    """Put together what is kept."""
    found, local, noise = assessed.sample, assessed.local, assessed.noise
    space, measurement, u = problem.space, problem.measurement, assessed.sample.particles
    linear, ends = space.from_unit(assessed.linear).T, space.from_unit(assessed.interval).T
    known, theta = knowledge(space, u, local.determined, problem.prior), assessed.point.theta[0]
    good = np.isfinite(found.drawn.mse)
    bands = bands_of(found.drawn.y[good], found.weights[good], noise_of_outputs(noise, measurement), LEVEL)
    n, sensor = len(found.weights), float(measurement.uncertainty[0])
    return Uncertainty(
        calibration=calibration,
        seed=seed,
        max_calls=max_calls,
        mse=float(assessed.point.mse[0]),
        level=LEVEL,
        noise=noise,
        sensor=sensor if np.isfinite(sensor) else None,
        has_prior=problem.prior is not None,
        parameters={
            name: Known(value, (lower, upper), (low, high), median, known[name])
            for name, value, (lower, upper), (low, median, high) in zip(
                space.names, theta.tolist(), linear.tolist(), ends.tolist(), strict=True
            )
        },
        pairs=compensations(space, u),
        null_directions=local.null_directions,
        sample=SampleFound(
            n=n,
            n_effective=found.n_effective,
            is_trusted=found.n_effective >= TRUSTED * n,
            best_mse=float(found.best.mse[0]),
            best_theta=space.named(space.from_unit(found.best.u[0])),
        ),
        outputs={
            output: Covered(
                share_within_simulated=share_within(measurement, bands.simulated, k),
                share_within_predictive=share_within(measurement, bands.predictive, k),
            )
            for k, output in enumerate(measurement.output_names)
        },
        ledger=Cost(
            n_differences=assessed.n_differences,
            n_taught=found.n_taught,
            n_sample=n,
            total=assessed.n_calls,
            n_warm_start=n_warm_start,
            by_equations=assessed.by_equations,
        ),
        n_failed=len(physical.failures),
        first_failure=next(iter(physical.failures), None),
        n_simulated=physical.n_simulated,
        time=measurement.time,
        sample_theta=found.drawn.theta,
        weights=found.weights,
        particles_theta=space.from_unit(u),
        simulated=bands.simulated,
        predictive=bands.predictive,
    )
