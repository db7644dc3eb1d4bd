"""The stage that says how sure a calibration is: identifiability, intervals, a posterior sample, bands.

Every simulated row is stored as it comes, and the rows follow from the calibration, the settings, the seed
and the list of stored rows that was written when the stage first began: interrupted, it goes on.
"""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem
from studies.physical_model import (
    failed_numbers,
    open_physical_model,
    open_watched_model,
    say_reused,
)
from studies.recipe import recipe_of
from studies.report.uncertainty import FITS_BETTER
from studies.report.wording import count
from studies.stages.adaptive_known import known_arrays
from studies.stages.calibrate import write_arrays
from studies.stages.guided import guide_of
from studies.stages.knowledge import prior_inputs, sensor_inputs
from studies.stages.known_rows import ChooseRows, KnownRows, judge_known
from studies.stages.pipeline import Outcome, StageError, Study, Summary, digest_of, run_stage, write_json
from studies.stages.restriction import (
    Restriction,
    free_space,
    held_numbers,
    parts_of,
    recipe_part,
    restriction_of,
)
from studies.stages.results import StoredCalibration, most_relevant, n_free_of
from studies.stages.uncertainty_results import StoredPosterior, log_posterior, posterior_files
from studies.tracking.origin import environment
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


def uncertainty_stage(
    study: Study, calibration: StoredCalibration, settings: UncertaintySettings, *, again: bool = False
) -> Outcome:
    """Say how sure a stored calibration is.

    Args:
        study: The study.
        calibration: The calibration.
        settings: What is asked for.
        again: Do it though it is finished.
    """
    case, restriction = study.case, restriction_of(calibration.numbers)
    space = free_space(case, restriction)
    sampling = sampling_within(settings.max_calls, space.n_parameters)
    asked = {
        "case": case.digest,
        "measurement": case.measurement.digest,
        "is_log": space.is_log.tolist(),
        "theta": calibration.numbers["theta"],
        "settings": asdict(settings),
        "sampling": asdict(sampling),
        "step": STEP,
        "seed": study.profile.seed,
        **prior_inputs(case, space),
        **(sensor_inputs(case) if settings.noise == "sensor" else {}),
        **({"state_equations": True} if calibration.learnt_equations else {}),
        **({} if restriction is None else {"held": dict(restriction.fixed)}),
    }
    # Bands of earlier versions took an output's weight and sampling for its noise.
    shares = case.measurement.scales * case.measurement.uncertainty / case.measurement.uncertainty[0]
    inputs = asked | ({} if np.allclose(shares, 1.0) else {"bands": "by sensor"})
    files = posterior_files(study, calibration.name)
    stage = f"uncertainty-{calibration.name}"

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        known = KnownRows(files.rows, digest_of(asked))
        numbers, arrays, n_simulated = judge_calibration_point(
            study,
            calibration.name,
            calibration.point[0],
            settings,
            known,
            restriction,
            state_equations=calibration.learnt_equations,
        )
        summary = {**numbers, "file": study.paths.recorded(files.numbers), "n_simulated": n_simulated}
        recipe = recipe_of(
            study,
            "uncertainty",
            command=_command(study, calibration, settings),
            settings=asdict(settings),
            calibration={
                "name": calibration.name,
                "theta": calibration.numbers["theta"],
                **({"state_equations": True} if calibration.learnt_equations else {}),
            },
            **recipe_part(restriction),
        )
        numbers |= {"recipe": recipe, "environment": environment()}
        write_arrays(files.arrays, arrays)
        write_json(files.numbers, numbers)
        wall_s = time.time() - started_s
        log_posterior(
            study,
            StoredPosterior(files, numbers, arrays),
            digest_of(inputs),
            started_s=started_s,
            wall_s=wall_s,
        )
        return summary, [files.numbers, files.arrays, files.rows]

    return run_stage(
        study,
        stage,
        what=f"differences and a posterior sample, {count(settings.max_calls, 'simulation')} at most",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"a sample worth {summary['sample']['n_effective']:.0f} parameter sets",
        again=again,
    )


def _command(study: Study, calibration: StoredCalibration, settings: UncertaintySettings) -> str:
    """Return the command line that judges this calibration so."""
    n_train, n_free = calibration.numbers["n_train"], n_free_of(calibration.numbers)
    of = "--method adaptive" if calibration.is_adaptive else f"--n-train {n_train}"
    return (
        f"studies uncertainty {study.command} {of}{most_relevant(n_free)} --noise {settings.noise} "
        f"--max-calls {settings.max_calls}"
    )


def judge_calibration_point(
    study: Study,
    name: str,
    theta: FloatArray,
    settings: UncertaintySettings,
    known_rows: ChooseRows,
    restriction: Restriction | None = None,
    *,
    state_equations: bool = False,
) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Say how sure a calibrated point is, and keep nothing but the simulations.

    Args:
        study: The study.
        name: What the calibration is called.
        theta: The point. Shape (p,). [per parameter]
        settings: What is asked for.
        known_rows: Rows that are known beforehand.
        restriction: Which parameters are held at what and are not judged; None for none.
        state_equations: Whether the calibration learnt state equations, which can be learnt again.

    Returns:
        The numbers, the arrays and how many rows were not stored before.
    """
    case = study.case
    opened = open_watched_model(study) if state_equations else open_physical_model(study)
    with opened as physical, study.console.bars() as bars:
        model = parts_of(physical, restriction)
        n_parameters, theta = model.parameter_space.n_parameters, model.reduced(theta)
        prior = Prior.of(model.parameter_space, case.measurement)
        problem = CalibrationProblem(model, case.measurement, prior)
        y = model.simulate(theta[None]).y[0]
        noise = noise_of(settings.noise, case.measurement, y, n_parameters)
        posterior = Posterior(noise, prior)
        rows = known_rows(physical, model, problem, lambda found: posterior.at(found.u, found.mse))
        known = judge_known(problem, physical, model, rows)
        guide = guide_of(physical, model, problem)
        if guide is not None and known.n:
            guide.note(known)
        if known.n and known.mse.min() < FITS_BETTER * float(case.measurement.mse(y[None])[0]):
            # What a calibration that ended early has left over is not noise.
            noise = noise_of(settings.noise, case.measurement, known.y[np.argmin(known.mse)], n_parameters)
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
    say_reused(study, f"uncertainty-{name}", physical, n_repeated=n_repeated)
    numbers, arrays = _told(study, name, settings, problem, found)
    numbers["ledger"] |= {"n_known": known.n}
    numbers |= failed_numbers(physical) | held_numbers(case, restriction)
    return numbers, arrays | known_arrays(rows, state_equations=state_equations), physical.n_simulated


def _told(
    study: Study,
    name: str,
    settings: UncertaintySettings,
    problem: CalibrationProblem,
    assessed: Assessment,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the results as numbers and arrays, of the free parameters alone."""
    case, found, local, noise = study.case, assessed.sample, assessed.local, assessed.noise
    space, measurement, u = problem.space, case.measurement, assessed.sample.particles.u
    linear = space.from_unit(assessed.linear)
    ends, known = space.from_unit(assessed.interval), knowledge(space, u, problem.prior)
    good = np.isfinite(found.drawn.mse)
    bands = bands_of(found.drawn.y[good], found.weights[good], noise_of_outputs(noise, measurement), LEVEL)
    n = len(found.weights)
    numbers = {
        "label": study.label,
        "note": case.note,
        "case_sha256": case.digest,
        "measurement_sha256": measurement.digest,
        "calibration": name,
        "mse": float(assessed.point.mse[0]),
        "settings": asdict(settings),
        "seed": study.profile.seed,
        "level": LEVEL,
        "noise": noise.to_dict(),
        "sensor": sensor if np.isfinite(sensor := float(measurement.uncertainty[0])) else None,
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
            **({"by_equations": True} if assessed.by_equations else {}),
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
