"""How long a training takes: measured on earlier trials, scaled from other sizes, or timed now."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simulation.case import Case
from simulation.errors import InputError
from studies.looking.project import Project, StudyLook
from studies.profile import Profile
from studies.report.wording import count
from studies.stages.pipeline import Study

N_TIMED = 5
"""Epochs between two looks at the clock where a training is timed now."""
N_MODES = 20
"""Shapes in made-up trajectories."""
MOST_TIMED_ROWS = 256
"""Rows on which a fit of processes is timed; the time for more grows no faster than their number."""
FAR = 2.0
"""A size so many times larger than all that were trained is timed, not scaled."""
CHEAP_BYTES = 2.5e8
"""A made-up training set larger than this is not timed. [byte]"""


@dataclass(frozen=True)
class TrialCost:
    """What a trial of a size costs.

    Args:
        seconds: its time, None where nothing tells. [s]
        basis: where that is known from.
    """

    seconds: float | None
    basis: str


def trial_costs(project: Project, study: Study, *, say: Callable[[str], None]) -> dict[int, TrialCost]:
    """Return the cost of a trial per training-set size.

    Args:
        project: holds the records of earlier trials.
        study: what would be tuned.
        say: told before some epochs are timed, which takes seconds.

    Raises:
        InputError: the profile's device is not there.
    """
    case, profile = study.case, study.profile
    own = {n_train: _own_trials(project, study, n_train) for n_train in profile.data.n_train}
    missing = [n_train for n_train, walls in own.items() if not walls]
    rates = _epoch_rates(project, case, profile)
    basis = f"scaled from trials of n_train {', '.join(map(str, sorted(rates)))}"
    if missing and max(missing) > FAR * max(rates, default=0):
        timed = [n for n in sorted({min(missing), max(missing)}) if _is_cheap(case, n)]
        if timed:
            say(f"timing some epochs of n_train {', '.join(map(str, timed))} on made-up data")
            try:
                rates |= {n_train: _timed_epoch(case, profile, n_train) for n_train in timed}
            except ValueError as error:  # such as a device that is not there
                raise InputError(f"profile {profile.name}: {error}") from None
            basis = "epochs timed now"
    found = {
        n: TrialCost(statistics.mean(walls), f"mean of {count(len(walls), 'trial')}")
        for n, walls in own.items()
        if walls
    }
    for n_train in missing:
        seconds = _scaled(rates, n_train) * _epochs(profile) if rates else None
        known = f"{basis}, without pruning" if rates else "unknown: no trial yet"
        found[n_train] = TrialCost(seconds, known)
    return found


def _own_trials(project: Project, study: Study, n_train: int) -> list[float]:
    """Return what earlier trials of a label and size took. [s]."""
    return [
        record.wall_s
        for look in project.studies
        if (look.label, look.n_train) == (study.label, n_train) and _is_alike(look, study.case, study.profile)
        for record in look.records
    ]


def _is_cheap(case: Case, n_train: int) -> bool:
    return 8.0 * n_train * case.measurement.y.size < CHEAP_BYTES


def _is_alike(study: StudyLook, case: Case, profile: Profile) -> bool:
    return study.entry.digests.get("case") == case.digest and study.entry.variant == profile.tuning.variant


def _epoch_rates(project: Project, case: Case, profile: Profile) -> dict[int, float]:
    """Return the time of an epoch by training-set size. [s]."""
    spent: dict[int, list[float]] = {}
    for study in project.studies:
        if _is_alike(study, case, profile):
            # The first trial of a process also waits for libraries to be loaded.
            counted = [
                record for record in study.records if record.n_epochs and record.index
            ] or study.records
            rates = [record.wall_s / record.n_epochs for record in counted if record.n_epochs]
            spent.setdefault(study.n_train, []).extend(rates)
    return {n_train: statistics.median(rates) for n_train, rates in spent.items() if rates}


def _scaled(rates: Mapping[int, float], n_train: int) -> float:
    """Return the time of an epoch of another size: between two on a line, beyond in proportion. [s].

    Small sets all take one step per epoch: below the smallest known size an epoch takes as long as there.
    """
    sizes: Sequence[int] = sorted(rates)
    if n_train > sizes[-1]:
        return rates[sizes[-1]] * n_train / sizes[-1]
    return float(np.exp(np.interp(np.log(n_train), np.log(sizes), np.log([rates[n] for n in sizes]))))


def _epochs(profile: Profile) -> int:
    from pelsvae.config import VARIANTS

    return profile.tuning.max_epochs or VARIANTS[profile.tuning.variant].max_epochs


def _timed_epoch(case: Case, profile: Profile, n_train: int) -> float:
    from pelsvae.config import VARIANTS
    from pelsvae.epochs import EpochReport
    from pelsvae.training import fit

    random = np.random.default_rng(0)
    shape, p = case.measurement.y.shape, case.parameter_space.n_parameters
    # Like a model's: smooth in the parameters, and of few shapes. Processes search longer for what is not.
    directions = random.standard_normal((p, N_MODES))
    modes = random.standard_normal((N_MODES, case.measurement.y.size)) / np.arange(1, N_MODES + 1)[:, None]

    def made_up(n: int) -> tuple[np.ndarray, np.ndarray]:
        u = random.random((n, p))
        y = np.sin(u @ directions) @ modes
        return case.parameter_space.from_unit(u), y.reshape(n, *shape)

    seen: list[float] = []

    def hear(report: EpochReport) -> None:
        seen.append(time.perf_counter())

    # As the trials will be trained.
    variant = VARIANTS[profile.tuning.variant].replace(device=profile.tuning.device, n_threads=1)
    validation = made_up(profile.data.n_validation)
    if variant.regressor == "gaussian-process":  # whose epochs are parts of one piece of work
        n = min(n_train, MOST_TIMED_ROWS)
        fitted = fit(*made_up(n), validation, config=variant, seed=0)
        return fitted.wall_s / variant.max_epochs * n_train / n
    config = variant.replace(max_epochs=2 * N_TIMED, patience=2 * N_TIMED, validate_every=N_TIMED)
    fit(*made_up(n_train), validation, config=config, seed=0, on_epoch=hear)
    return (seen[-1] - seen[0]) / N_TIMED if len(seen) > 1 else 0.0
