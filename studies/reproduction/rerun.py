"""Making a result again in its rebuilt study: train, calibrate, judge or estimate, on as many threads."""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import EpochReport
from pelsvae.training import FitResult
from simulation.errors import InputError
from studies.reproduction.rebuild import Rebuilt
from studies.reproduction.recorded import Arrays, Recorded, as_arrays, weights_digest
from studies.tuning.pruning import Pruner
from studies.tuning.study_data import load_data
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_attempt import failure_reason
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_training import TrialOutcome, train_trial

if TYPE_CHECKING:
    from studies.stages.known_rows import Known

Made = tuple[dict[str, Any], Arrays]
TIME_LIMIT = "reached its limit of"
"""How the reason begins of a trial that was ended by a limit of time."""

_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class _LastEpochError(Exception):
    """The training has gone as far as the recorded one."""


def make_again(rebuilt: Rebuilt) -> Made:
    """Make a recorded result again.

    Args:
        rebuilt: its study.

    Returns:
        Its numbers and arrays, by the names under which they were recorded.
    """
    makers: dict[str, Callable[[Rebuilt], Made]] = {
        "training": _training,
        "calibration": _calibration,
        "adaptive": _adaptive,
        "uncertainty": _uncertainty,
        "sensitivity": _sensitivity,
    }
    kind = rebuilt.recorded.kind
    if kind not in makers:
        raise InputError(f"{rebuilt.recorded.name} is a {kind}, which this version cannot make again")
    n_threads = rebuilt.recorded.environment.get("n_threads", "1" if kind == "training" else "")
    with _threads(n_threads):
        return makers[kind](rebuilt)


def _training(rebuilt: Rebuilt) -> Made:
    recorded, trial = rebuilt.recorded, rebuilt.recorded.trial
    if trial is None:
        raise InputError(f"{recorded.name} has no record of its settings")
    spec = rebuilt.spec()
    if spec.name != trial.study:
        rebuilt.notes.append(f"what is rebuilt is another study: {spec.name}")
    outcome = TrialOutcome()
    folder = rebuilt.study.paths.root / "surrogate"
    # A clock ended it; where, is on record, and another machine's clock would end it elsewhere.
    is_late = trial.state == "pruned" and trial.reason.startswith(TIME_LIMIT)
    last_epoch = trial.n_epochs if is_late else None
    judge = _judge(rebuilt, spec, trial)
    fitted = _train(
        rebuilt, spec, trial.config, trial.seed, outcome=outcome, is_hopeless=judge, last_epoch=last_epoch
    )
    if is_late and outcome.n_epochs == last_epoch:
        outcome.state, outcome.reason = trial.state, trial.reason
        outcome.metrics = {"val/mae": min(outcome.history["validation_mae"])}
    numbers: dict[str, Any] = {
        "state": outcome.state,
        **outcome.metrics,
        "n_rows": len(load_data(spec).train[0]),
        "n_epochs": outcome.n_epochs,
        "best_epoch": fitted.best_epoch if fitted else 0,
        "reports": outcome.reports,
        "reason": outcome.reason,
    }
    if fitted:
        fitted.surrogate.save(folder)
        numbers["weights"] = weights_digest(folder)
    return numbers, as_arrays(fitted.history if fitted else outcome.history)


def _train(
    rebuilt: Rebuilt,
    spec: StudySpec,
    settings: Mapping[str, Any],
    seed: int,
    *,
    outcome: TrialOutcome,
    is_hopeless: Callable[[int, float], bool],
    last_epoch: int | None = None,
) -> FitResult | None:
    config = SurrogateConfig(**settings)
    with rebuilt.study.console.progress("epochs", config.max_epochs) as advance:

        def hear(report: EpochReport) -> None:
            advance(report.epoch, report.max_epochs)
            if last_epoch is not None and report.epoch > last_epoch:
                raise _LastEpochError

        try:
            train_trial(
                spec, config, seed, load_data(spec), outcome=outcome, on_epoch=hear, is_hopeless=is_hopeless
            )
        except OSError:
            raise
        except _LastEpochError:
            pass
        except Exception as error:  # as in the study: whatever a configuration provokes is its result
            outcome.state, outcome.reason, outcome.metrics = "failed", failure_reason(error), {}
    return outcome.fitted


def _judge(rebuilt: Rebuilt, spec: StudySpec, trial: TrialRecord) -> Callable[[int, float], bool]:
    """Return who prunes: the trials it was compared with, or else the epoch at which it was pruned."""
    known = range(max(0, trial.index - spec.n_parallel + 1))
    rivals = [rival for rival in rebuilt.recorded.rivals if rival.index in known]
    if len(rivals) == len(known):
        return Pruner(spec, rivals).is_hopeless
    last = max(map(int, trial.reports), default=0)
    if trial.state != "pruned":
        return lambda epoch, value: False
    rebuilt.notes.append("the trials it was compared with are not recorded here; it is stopped where it was")
    return lambda epoch, value: epoch >= last


def _calibration(rebuilt: Rebuilt) -> Made:
    from studies.stages.calibrate import calibrate
    from studies.stages.restriction import restriction_of

    recipe = rebuilt.recorded.recipe
    surrogate = rebuilt.surrogate(lambda folder: _train_surrogate(rebuilt, folder))
    # Which parameters are relevant is not found out again, here and below.
    numbers, arrays, _ = calibrate(rebuilt.study, surrogate, recipe["n_train"], restriction_of(recipe))
    folder = rebuilt.study.paths.root / "surrogate"
    return _case_digests(rebuilt) | {"weights": weights_digest(folder)} | numbers, arrays


def _train_surrogate(rebuilt: Rebuilt, folder: Path) -> None:
    wanted = rebuilt.recorded.recipe["surrogate"]
    outcome = TrialOutcome()
    fitted = _train(
        rebuilt,
        rebuilt.spec(),
        wanted["config"],
        wanted["seed"],
        outcome=outcome,
        is_hopeless=lambda epoch, value: False,
    )
    if fitted is None:
        raise InputError(
            f"the surrogate of {rebuilt.recorded.name} cannot be trained again: {outcome.reason}"
        )
    fitted.surrogate.save(folder)


def _adaptive(rebuilt: Rebuilt) -> Made:
    from studies.calibration.adaptive import Adaptive
    from studies.stages.adaptive import calibrate_adaptively
    from studies.stages.restriction import restriction_of

    recipe = rebuilt.recorded.recipe
    settings = Adaptive(**recipe["settings"])
    known = _known(rebuilt) if "n_known" in rebuilt.recorded.numbers else None
    numbers, arrays, _ = calibrate_adaptively(
        rebuilt.study,
        settings,
        restriction_of(recipe),
        None if known is None else lambda *_: known,
        state_equations="state_equations" in rebuilt.recorded.numbers,
    )
    return numbers, arrays


def _uncertainty(rebuilt: Rebuilt) -> Made:
    from studies.stages.restriction import restriction_of
    from studies.stages.uncertainty import UncertaintySettings, judge_calibration_point

    recipe = rebuilt.recorded.recipe
    point, case = recipe["calibration"], rebuilt.study.case
    theta = np.array([point["theta"][name] for name in case.parameter_space.names])
    known = _known(rebuilt)
    numbers, made, _ = judge_calibration_point(
        rebuilt.study,
        point["name"],
        theta,
        UncertaintySettings(**recipe["settings"]),
        lambda *_: known,
        restriction_of(recipe),
        state_equations=point.get("state_equations", False),
    )
    return numbers, made


def _known(rebuilt: Rebuilt) -> "Known":
    """Return the rows that were known when a result was begun."""
    from studies.stages.known_rows import Known

    arrays = rebuilt.recorded.arrays
    theta = arrays.get("known_theta")
    if theta is None:
        raise InputError(f"{rebuilt.recorded.name} does not tell which simulations were known when it began")
    # Who learnt state equations before this was noted knew rows with states alone.
    usual = np.full(len(theta), "state_equations" in rebuilt.recorded.numbers)
    return Known(theta, np.asarray(arrays.get("known_watched", usual), dtype=np.bool_))


def _sensitivity(rebuilt: Rebuilt) -> Made:
    from studies.stages.results import read_arrays
    from studies.stages.simulate import estimate_indices

    study = rebuilt.study
    n_rows = study.profile.sensitivity.n_base * (study.case.parameter_space.n_parameters + 2)
    summary, indices = estimate_indices(study, n_rows)
    file = study.paths.root / "sensitivity.npz"
    indices.save(file)
    return dict(summary), read_arrays(file)


def _case_digests(rebuilt: Rebuilt) -> dict[str, Any]:
    case = rebuilt.study.case
    return {"case_sha256": case.digest, "measurement_sha256": case.measurement.digest}


@contextmanager
def _threads(n_threads: str) -> Iterator[None]:
    """Let libraries that are loaded, and those to come, use as many threads as were recorded."""
    if not n_threads:
        yield
        return
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, n_threads))
    try:
        with threadpool_limits(int(n_threads)):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def expected(recorded: Recorded) -> dict[str, Any]:
    """Return a result's recorded numbers under the names that `make_again` gives."""
    numbers = dict(recorded.numbers)
    surrogate = numbers.pop("surrogate", None)
    if surrogate:
        numbers["weights"] = surrogate["sha256"]["weights.npz"]
    numbers.pop("surrogate_errors", None)  # the surrogate's, which are its training's to reproduce
    return numbers
