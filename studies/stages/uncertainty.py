"""The stage that says how sure a calibration is: identifiability, intervals, a posterior sample, bands.

Every simulated row is stored as it comes, and the rows follow from the calibration, the settings, the seed
and the list of stored rows that was written when the stage first began: interrupted, it goes on.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from simulation.errors import InputError
from studies.calibration.problem import CalibrationProblem
from studies.physical_model import failed_numbers, open_physical_model, open_watched_model, say_reused
from studies.report.uncertainty import FITS_BETTER
from studies.report.wording import count, listed
from studies.stages.guided import guide_of
from studies.stages.knowledge import case_inputs, prior_of, sensor_inputs
from studies.stages.known_rows import KnownRows
from studies.stages.pipeline import Outcome, Stage, StageError, Study
from studies.stages.results import (
    ADAPTIVE,
    Arrays,
    Numbers,
    ResultFiles,
    StoredResult,
    keep_result,
    stored_calibrations,
)
from studies.stages.tracking import log_posterior
from studies.uncertainty.assess import STEP, Assessment, assess, sampling_within
from studies.uncertainty.bands import bands_of, noise_of_outputs, share_within
from studies.uncertainty.density import Posterior
from studies.uncertainty.findings import LEVEL, compensations, correlation, knowledge
from studies.uncertainty.noise import NoiseKind, noise_of
from studies.uncertainty.stand_in import particles_for

LEAST_BUDGET, BUDGET_PER_PARAMETER = 100, 20
"""Most calls unless others are asked for; a sample that is good earlier ends earlier."""

TRUSTED = 0.3
"""A sample that is worth less than this share of its size is not to be relied upon."""


def usual_calls(n_parameters: int) -> int:
    """Return how many rows may be asked of the model unless the user says otherwise."""
    return max(LEAST_BUDGET, BUDGET_PER_PARAMETER * n_parameters)


@dataclass(frozen=True)
class UncertaintySettings:
    """What is asked for.

    Attributes:
        noise: Model of the noise.
        max_calls: Most rows that may be asked of the model.
    """

    noise: NoiseKind
    max_calls: int


def calibration_to_judge(study: Study, method: str | None, sizes: Sequence[int] | None) -> StoredResult:
    """Return the calibration that was asked for: the adaptive one, else the best of the paper's.

    Args:
        study: The study.
        method: "paper" or "adaptive", None for either.
        sizes: Training-set sizes that were named, at most one; None for any.

    Raises:
        InputError: There is none.
    """
    if sizes and (method == ADAPTIVE or len(sizes) > 1):
        raise InputError("--n-train names one calibration of --method paper; give one size, or leave it away")
    every = list(stored_calibrations(study))
    fitting = [
        one
        for one in every
        if math.isfinite(one.mse)
        and (not sizes or one.numbers["n_train"] == sizes[0])
        and (method is None or one.is_adaptive == (method == ADAPTIVE))
    ]
    if fitting:
        return min(fitting, key=lambda one: (not one.is_adaptive, one.mse))
    asked = f"n_train = {sizes[0]}" if sizes else f"--method {method}" if method else "any kind"
    how = f" --n-train {sizes[0]}" if sizes else " --method paper" if method == "paper" else ""
    is_other = not every and any(study.results.glob("calibration-*.json"))
    other = " (what is stored is of another window, measurement, scale or prior)" if is_other else ""
    there = f", there is {listed(one.name for one in every)}" if every else ""
    raise InputError(
        f"{study.label} has no calibration of {asked}{other}{there}; type: studies calibrate "
        f"{study.command}{how}"
    )


def uncertainty_stage(
    study: Study, calibration: StoredResult, settings: UncertaintySettings, *, again: bool = False
) -> Outcome:
    """Say how sure a stored calibration is.

    Args:
        study: The study.
        calibration: The calibration.
        settings: What is asked for.
        again: Do it though it is finished.
    """
    case, name = study.case, calibration.name
    inputs = {
        **case_inputs(case),
        "theta": calibration.numbers["theta"],
        "settings": asdict(settings),
        "sampling": asdict(sampling_within(settings.max_calls, case.parameter_space.n_parameters)),
        "step": STEP,
        "seed": study.profile.seed,
        **(sensor_inputs(case) if settings.noise == "sensor" else {}),
        **({"state_equations": True} if calibration.learnt_equations else {}),
    }
    files = ResultFiles.of(study, "posterior", name)

    what = f"differences and a posterior sample, {count(settings.max_calls, 'simulation')} at most"
    stage = Stage(study, f"uncertainty-{name}", what, inputs)
    before = stage.finished(
        lambda summary: f"a sample worth {summary['sample']['n_effective']:.0f} parameter sets", again=again
    )
    if before is not None:
        return before
    with stage.work() as work:
        known_rows = KnownRows(files.rows, stage.digest)
        numbers, arrays, n_simulated = _judge(study, calibration, settings, known_rows)
        return keep_result(
            work,
            files,
            numbers,
            arrays,
            this_time={"n_simulated": n_simulated},
            recipe={"kind": "uncertainty", "settings": asdict(settings), "calibration": name},
            log=log_posterior,
            more_files=[files.rows],
        )


def _judge(
    study: Study, calibration: StoredResult, settings: UncertaintySettings, known_rows: KnownRows
) -> tuple[Numbers, Arrays, int]:
    """Say how sure a calibrated point is, and keep nothing but the simulations."""
    case, theta, prior = study.case, calibration.arrays["theta"], prior_of(study.case)
    measurement, n_parameters = case.measurement, case.parameter_space.n_parameters
    opened = open_watched_model(study) if calibration.learnt_equations else open_physical_model(study)
    with opened as physical, study.console.bars() as bars:
        problem = CalibrationProblem(physical, measurement, prior)
        y = physical.simulate(theta[None]).y[0]
        noise = noise_of(settings.noise, measurement, y, n_parameters)
        posterior = Posterior(noise, prior)
        rows = known_rows(physical, problem, lambda found: posterior.at(found.u, found.mse))
        known = rows.judged(physical, problem)
        guide = guide_of(physical, problem)
        if guide is not None and known.n:
            guide.note(known)
        if known.n and known.mse.min() < FITS_BETTER * float(measurement.mse(y[None])[0]):
            # What a calibration that ended early has left over is not noise.
            noise = noise_of(settings.noise, measurement, known.y[np.argmin(known.mse)], n_parameters)
        stand_in = None if guide is None else guide.model
        sampling = sampling_within(settings.max_calls, n_parameters)
        if stand_in is not None:
            sampling = replace(sampling, n_of_stand_in=particles_for(stand_in.equations.flow.n_operations))
        found = assess(
            problem,
            theta,
            y,
            noise=noise,
            known=known,
            sampling=sampling,
            seed=study.profile.seed,
            stand_in=stand_in,
            on_phase=bars,
        )
    if not np.isfinite(found.sample.drawn.mse).any():
        raise StageError(f"no simulation of the sample succeeded; type: studies check {study.command}")
    # The point is asked first, to know the noise, and then among the known rows once more.
    n_repeated = int(np.all(rows.theta == theta, axis=1).sum())
    say_reused(study, f"uncertainty-{calibration.name}", physical, n_repeated=n_repeated)
    numbers, arrays = _results(study, problem, found)
    numbers |= {"calibration": calibration.name, "settings": asdict(settings), **failed_numbers(physical)}
    numbers["ledger"] |= {"n_known": known.n}
    return numbers, arrays | rows.arrays, physical.n_simulated


def _results(study: Study, problem: CalibrationProblem, assessed: Assessment) -> tuple[Numbers, Arrays]:
    """Return the results as numbers and arrays."""
    found, local, noise = assessed.sample, assessed.local, assessed.noise
    space, measurement, u = problem.space, problem.measurement, assessed.sample.particles.u
    linear = space.from_unit(assessed.linear)
    ends, known = space.from_unit(assessed.interval), knowledge(space, u, problem.prior)
    good = np.isfinite(found.drawn.mse)
    bands = bands_of(found.drawn.y[good], found.weights[good], noise_of_outputs(noise, measurement), LEVEL)
    n, sensor = len(found.weights), float(measurement.uncertainty[0])
    numbers = {
        "mse": float(assessed.point.mse[0]),
        "seed": study.profile.seed,
        "level": LEVEL,
        "noise": asdict(noise),
        "sensor": sensor if np.isfinite(sensor) else None,
        "has_prior": problem.prior is not None,
        "parameters": {
            parameter: {
                "calibrated": float(assessed.point.theta[0, j]),
                "linear": linear[:, j].tolist(),
                "interval": ends[[0, 2], j].tolist(),
                "median": float(ends[1, j]),
                "known": known[parameter],
            }
            for j, parameter in enumerate(space.names)
        },
        "pairs": [pair.to_dict() for pair in compensations(space, u)],
        "identifiability": local.to_dict(),
        "sample": {
            "n": n,
            "n_effective": found.n_effective,
            "is_trusted": found.n_effective >= TRUSTED * n,
            "n_particles": len(found.particles.u),
            "n_powers": found.particles.n_powers,
            "acceptance": found.particles.acceptance,
            "best_mse": found.best_mse,
            "best_theta": dict(zip(space.names, space.from_unit(found.best_u).tolist(), strict=True)),
        },
        "outputs": {
            output: {
                "share_within_simulated": share_within(measurement, bands.simulated, k),
                "share_within_predictive": share_within(measurement, bands.predictive, k),
                "mean_width": float(np.mean(bands.simulated[1, :, k] - bands.simulated[0, :, k])),
            }
            for k, output in enumerate(measurement.output_names)
        },
        "ledger": {
            "n_differences": assessed.n_differences,
            "n_taught": found.n_taught,
            "n_sample": n,
            "total": assessed.n_calls,
            "by_equations": assessed.by_equations,
        },
    }
    arrays = {
        "time": measurement.time,
        "theta": assessed.point.theta[0],
        "sample_theta": found.drawn.theta,
        "sample_mse": found.drawn.mse,
        "weights": found.weights,
        "log_ratios": found.log_ratios,
        "particles_theta": space.from_unit(u),
        "simulated": bands.simulated,
        "predictive": bands.predictive,
        "singular_values": local.singular_values,
        "directions": local.directions,
        "spread": local.spread,
        "correlation": local.correlation,
        "posterior_correlation": correlation(u),
    }
    return numbers, arrays
