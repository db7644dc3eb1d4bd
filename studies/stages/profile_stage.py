"""The stage that follows profile likelihoods, and has the model confirm the ends of their intervals."""

from dataclasses import asdict

import numpy as np

from studies.calibration.descent import objectives
from studies.calibration.uncertainty.emulated import emulated_residuals, weighed
from studies.calibration.uncertainty.findings import LEVEL
from studies.calibration.uncertainty.profiles import LIMIT, profiles
from studies.calibration.uncertainty.rows import informative_rows, joined
from studies.results.outcome import Outcome
from studies.results.profiled import Profiled, Profiles
from studies.results.stage_results import Calibration, Uncertainty
from studies.simulation_time import duration
from studies.stages.judged_model import judged_model
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_profiles
from studies.stages.warm_start import WarmStart
from studies.task import Task
from studies.words.wording import count

ROUNDS, AGREED = 4, 0.05
"""Times that ends are simulated for a process to learn from, until roots differ by this share at most."""

DECIMALS = 8
"""Of the points that are simulated, so that a store finds them again."""

MOVES = 0.5
"""Way along a profile from which a parameter moves with another one, as a share of that one's, in ranges."""


def profile_stage(
    task: Task,
    calibration: Outcome[Calibration],
    uncertainty: Outcome[Uncertainty],
    *,
    again: bool = False,
) -> Outcome[Profiles]:
    """Follow the profile likelihood of every parameter.

    Args:
        task: The study.
        calibration: The calibration.
        uncertainty: How sure it is: noise, and intervals to begin with.
        again: Do it though it is finished.
    """
    case = task.case
    n_ends = 2 * case.parameter_space.n_parameters
    inputs = {
        "case": case.digest,
        "uncertainty": uncertainty.digest,
        "theta": calibration.result.theta,
        "noise": asdict(uncertainty.result.noise),
    }
    what = f"profile likelihoods, {count(n_ends, 'simulation')} at the ends of intervals"
    stage = Stage(task, f"profiles-{calibration.name}", f"{what}{duration(task, n_ends)}", inputs, Profiles)
    start = WarmStart(stage.file.with_name(f"{stage.name}-rows.npz"), stage.digest, informative_rows)
    return stage.once(
        lambda: _followed(task, calibration, uncertainty.result, start),
        again=again,
        files=[start.file],
        log=log_profiles,
    )


def _followed(
    task: Task, calibration: Outcome[Calibration], found: Uncertainty, start: WarmStart
) -> Profiles:
    """Follow the profiles, and simulate at their ends until these agree."""
    space, noise = task.case.parameter_space, found.noise
    p, n_calls = space.n_parameters, 0
    with judged_model(task, calibration, start, noise.kind) as model, task.console.bars() as bars:
        problem, emulator = model.problem, model.emulator
        prior, rows = weighed(problem.prior, noise), model.known
        ends = space.to_unit(found.interval if found.sample.is_trusted else found.linear)
        best = np.clip(space.to_unit(found.point), 0.0, 1.0)
        rows = joined([rows, problem.evaluate(best[None])])
        n_rounds = 0
        while True:
            bars("profiles", n_rounds, ROUNDS)
            n_rounds += 1
            residuals = emulated_residuals(problem, rows, emulator)
            every = profiles(residuals, prior, best, 0.5 * (ends[1] - ends[0]), noise.unit)
            points = np.asarray(np.vstack([every.best[None], *every.points]).round(DECIMALS), np.float64)
            answer = problem.evaluate(points)
            n_calls += len(points)
            rows = joined([rows, answer])
            value, least = (objectives(prior, one.u, one.residuals) for one in (answer, rows))
            rise = (value[1:] - least.min()).reshape(2, p) / noise.unit
            n_last = np.isfinite(every.roots).sum(axis=1) - 1
            at_ends = np.stack([every.roots[:, 0], every.roots[np.arange(p), n_last]])
            expected = np.where(every.is_open, at_ends, LIMIT)
            is_confirmed = bool((np.abs(np.sqrt(np.maximum(rise, 0.0)) - expected) <= AGREED * LIMIT).all())
            # Equations are exact, or they are none: more rows do not change them.
            if is_confirmed or emulator is not None or n_rounds == ROUNDS:
                break
    points = every.points.copy()
    if emulator is None:
        # Roots rise about straight: from what was simulated an end moves to where its root is the limit.
        share = np.clip(LIMIT / np.sqrt(np.maximum(rise, 0.25 * LIMIT**2)), 0.5, 2.0)
        moved = every.best + (every.ends - every.best) * np.where(every.is_open, 1.0, share)
        points[:, np.arange(p), np.arange(p)] = np.clip(moved, 0.0, 1.0)
    theta = space.from_unit(points.reshape(-1, p)).reshape(2, p, p)
    low, high = np.diagonal(theta, axis1=1, axis2=2)
    travelled = np.abs(every.points - every.best)
    own = np.diagonal(travelled, axis1=1, axis2=2)
    # Of the farther end alone: the nearer one may lie at a bound beside the best point.
    far = np.argmax(own, axis=0)
    ways = travelled[far, np.arange(p)]
    is_moved = (ways >= MOVES * np.diag(ways)[:, None]) & ~np.eye(p, dtype=np.bool_)
    parameters = {
        name: Profiled(
            interval=(float(low[j]), float(high[j])),
            at_bound=(bool(every.is_open[0, j]), bool(every.is_open[1, j])),
            rise=(float(rise[0, j]), float(rise[1, j])),
            moves=tuple(one for one, moves in zip(space.names, is_moved[j], strict=True) if moves),
        )
        for j, name in enumerate(space.names)
    }
    return Profiles(
        calibration=calibration.name,
        level=LEVEL,
        limit=LIMIT**2,
        parameters=parameters,
        n_calls=n_calls,
        by_equations=emulator is not None,
        is_confirmed=is_confirmed,
        at=every.at,
        rises=every.roots**2,
    )
