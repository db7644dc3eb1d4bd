"""The stage that calibrates without a surrogate: it needs the case alone, and loses no simulation."""

import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from simulation.case import Case
from simulation.errors import InputError, OutOfTimeError
from simulation.pool.execution import commonest
from simulation.store.stored_model import StoredModel
from studies.calibration.hidden_network.inputs import network_of_stores
from studies.calibration.ledger import Ledger
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import Progress
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.search.row_choice import best_and_far
from studies.calibration.state_equations.experiments_ode import learned_ode
from studies.calibration.state_equations.learned_ode import LEAST_CALLS, LearnedODE
from studies.calibration.state_equations.states import StateSignals, why_unwatched
from studies.physical_model import (
    TIME_OVER,
    StoredWatchedModel,
    checked_file,
    open_physical_model,
    open_watched_model,
    say_reused,
)
from studies.results.outcome import Outcome, digest_of
from studies.results.stage_results import ADAPTIVE, Calibration, EquationsFound
from studies.simulation_time import duration
from studies.stages.calibrated_point import calibration_at, repeat_best, validation_inputs
from studies.stages.knowledge import case_inputs, prior_of
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_calibration
from studies.stages.warm_start import ChooseRows, WarmStart, checked_in_box, stored_in_box
from studies.task import StageError, Task
from studies.words.console import OnBar
from studies.words.wording import count, quantity, square_of

MAX_CALLS = 100
STAGE = f"calibrate-{ADAPTIVE}"
# Where none of the first rows can be simulated, more of them are a waste.
N_HOPELESS = 20
# Rows whose states are tried at once before any was read: more failures than these end a batch.
MOST_AT_FIRST = 8
# A line for those who read a log instead of watching a bar. [s]
NEWS_EVERY_S = 30.0


def adaptive_stage(
    task: Task,
    *,
    max_calls: int | None,
    n_parallel: int,
    target_mse: float | None,
    from_stored: bool | None,
    state_equations: bool | None,
    again: bool,
) -> Outcome[Calibration]:
    """Calibrate with the physical model alone.

    Every simulation is stored as soon as it is finished and the rows follow from case, settings and seed: a
    calibration that was interrupted reads what it had and goes on.

    Args:
        task: the task.
        max_calls: most simulations, None for the usual number.
        n_parallel: rows per round.
        target_mse: error to stop at, or None. [first output's unit squared]
        from_stored: whether to start from the simulations that are stored, whatever they were made for; None
            for those of a check.
        state_equations: whether to learn the model's state equations from the states that its FMU shows; None
            does it where it can.
        again: calibrate though it is finished, with what is stored now.

    Raises:
        InputError: the budget is smaller than the first design, or the FMU does not show its states.
    """
    learns = are_state_equations_learnt(task.case, state_equations)
    settings = Adaptive.for_sensor(
        float(task.case.measurement.uncertainty[0]),
        max_calls=MAX_CALLS if max_calls is None else max_calls,
        n_parallel=n_parallel,
        target_mse=target_mse,
    )
    has_rows = checked_file(task.paths, task.case).is_file() if from_stored is None else from_stored
    if not has_rows:
        _check_budget(settings, task.case.parameter_space.n_parameters, learns=learns)
    case = task.case
    inputs = {
        **case_inputs(case),
        "settings": asdict(settings),
        "seed": task.profile.seed,
        **validation_inputs(case),
        **({} if from_stored is None else {"from_stored": from_stored}),
        **({"state_equations": True} if learns else {}),
    }
    equations = "state equations or " if learns else ""
    what = (
        f"{equations}a Gaussian process of the residuals, {count(settings.max_calls, 'simulation')} at most"
        f"{duration(task, settings.max_calls, min(n_parallel, task.n_jobs))}"
    )
    stage = Stage(task, STAGE, what, inputs, Calibration, {"kind": "adaptive", "settings": asdict(settings)})
    start, files = None, list[Path]()
    if from_stored is not False:
        # Another budget or target goes on with the same rows, as does what was begun again and interrupted.
        any_end = replace(settings, max_calls=1, target_mse=None)
        question = inputs | {"settings": asdict(any_end)}
        files = [stage.file.with_name(f"{STAGE}-rows.npz")]
        rows = stored_in_box if from_stored else checked_in_box(task.paths, case)
        start = WarmStart(files[0], digest_of(question), best_and_far, rows, anew=again and stage.is_anew)

    def calibrated() -> Calibration:
        found = calibrate_adaptively(task, settings, start, state_equations=learns)
        if from_stored and found.n_warm_start is None:
            task.console.say("no good simulation within the bounds was stored: it began with none")
        return found

    return stage.once(
        calibrated,
        again=again,
        files=files,
        log=log_calibration,
    )


def _check_budget(settings: Adaptive, n_parameters: int, *, learns: bool) -> None:
    """Refuse a budget that is smaller than the first design of a calibration."""
    n_design = settings.design_size(n_parameters)
    n_start = min(n_design, LEAST_CALLS) if learns else n_design
    if settings.max_calls < n_start:
        raise InputError(
            f"--max-calls {settings.max_calls} must be at least {n_start}: with "
            f"{count(n_parameters, 'parameter')} the search begins with {n_start} simulations; better "
            f"{2 * n_start} or more"
        )


def calibrate_adaptively(
    task: Task,
    settings: Adaptive,
    start: ChooseRows | None,
    *,
    state_equations: bool,
) -> Calibration:
    """Calibrate and keep nothing but the simulations.

    Args:
        task: the task.
        settings: how to search.
        start: which stored simulations to start from, None for none.
        state_equations: whether to learn the model's state equations.
    """
    case, names = task.case, task.case.parameter_space.names
    n_first = min(settings.n_parallel, MOST_AT_FIRST)
    opened = open_watched_model(task, n_first=n_first) if state_equations else open_physical_model(task)
    with opened as physical, task.console.bars() as bars:
        problem = CalibrationProblem(physical, case.measurement, prior_of(case), case.layout)
        learned_ode = learned_ode_of(task.case, physical, problem)
        rows = known = None
        if start is not None:
            rows = start(physical, problem, lambda found: -found.objective)
            rows = rows if len(rows.theta) else None
            known = None if rows is None else rows.judged(physical, problem)
        _say_start(task, physical, None if known is None else known.n)
        n_read = physical.n_reused
        reporter = _Reporter(task, physical, bars)
        try:
            result = settings.minimize(
                problem,
                seed=task.profile.seed,
                known=known,
                learned_ode=learned_ode,
                network_inputs=None if state_equations else network_of_stores(case),
                on_progress=reporter,
            )
        except OutOfTimeError as over:
            raise StageError(f"{TIME_OVER}; {reporter.news or 'no call'} so far") from over
        if not np.isfinite(result.mse):
            raise _hopeless(task, physical)
        repeated = repeat_best(physical, result.theta, result.n_calls)
    say_reused(task, STAGE, physical, n_repeated=n_read)
    return calibration_at(
        task,
        physical,
        result,
        repeated=repeated,
        ledger=Ledger(n_adaptive=result.n_calls + physical.n_asked_twice),
        history=result.history,
        method="adaptive",
        n_train=0,
        settings=asdict(settings),
        left=result.left,
        n_rounds=result.n_rounds,
        n_warm_start=None if known is None else known.n,
        expected_gain=result.expected_gain if np.isfinite(result.expected_gain) else None,
        without_effect=tuple(name for name, is_so in zip(names, result.is_flat, strict=True) if is_so),
        state_equations=equations_found(learned_ode, physical),
        start_theta=None if rows is None else rows.theta,
        start_watched=None if rows is None else rows.watched,
    )


def _say_start(task: Task, physical: StoredModel, n_start: int | None) -> None:
    """Say from how many stored simulations it starts, None for none."""
    if n_start is not None:
        task.console.say(f"begins with {count(n_start, 'stored simulation')} of this model")
    elif n_good := int(physical.store.find_good(stored_in_box(physical)).sum()):
        stored = count(n_good, "stored simulation")
        task.console.say(f"{stored} of this model: --from-stored begins with the best")


class _Reporter:
    """Reports every round, on a bar or now and then in a line, and ends a hopeless search.

    Attributes:
        news: The calls so far and the best error; "" before the first.
    """

    def __init__(self, task: Task, physical: StoredModel, bars: OnBar) -> None:
        self._task, self._physical, self._bars = task, physical, bars
        self._last_said = time.monotonic()
        self.news = ""

    def __call__(self, now: Progress) -> None:
        task, case, failures = self._task, self._task.case, self._physical.failures
        if now.n_done >= N_HOPELESS and not np.isfinite(now.best_mse):
            raise _hopeless(task, self._physical)
        best = f"best {case.measurement.error_name} "
        best += quantity(now.best_mse, square_of(case.outputs[0].unit), 4)
        if case.policy.is_hopeless(now.n_done, len(failures)):
            raise StageError(
                f"{len(failures)} of {count(now.n_done, 'simulation')} failed, more than "
                f"simulation.max_failed_share = {case.policy.max_failed_share:g} allows; the commonest "
                f"reason: {commonest(failures)[0]}; {best} so far, and the finished simulations are "
                f"kept; narrow the bounds (studies check {task.command} says where it fails) or raise the "
                "share"
            )
        calls = count(now.n_done, "call")
        self.news = f"{calls}, {best}" if np.isfinite(now.best_mse) else calls
        news = f"{self.news}, now: {now.thinks_of}" if now.thinks_of else self.news
        self._bars("adaptive", now.n_done, now.n_total or now.n_done, f", {news}")
        if not task.console.is_live and time.monotonic() - self._last_said > NEWS_EVERY_S:
            self._last_said = time.monotonic()
            task.console.say(f"{STAGE}: {news}")


def _hopeless(task: Task, physical: StoredModel) -> StageError:
    return StageError(
        f"none of {count(len(physical.failures), 'simulation')} succeeded, the first one: "
        f"{physical.failures[0]}; type: studies check {task.command}"
    )


def are_state_equations_learnt(case: Case, wish: bool | None) -> bool:
    """Return whether a calibration learns state equations.

    Args:
        case: the case.
        wish: what the user said, None for nothing: then it does where it can.

    Raises:
        InputError: the user wants it, and the FMU does not show its states.
    """
    if wish is None:
        return not why_unwatched(case)
    for one in case.experiments or (case,):
        if wish:
            StateSignals.of(one)
    return wish


def learned_ode_of(case: Case, physical: StoredModel, problem: CalibrationProblem) -> LearnedODE | None:
    """Return what learns the state equations of a problem, None where the states are not watched."""
    if not isinstance(physical, StoredWatchedModel):
        return None
    return learned_ode(case, physical.watching, problem)


def equations_found(ode: LearnedODE | None, physical: StoredModel) -> EquationsFound | None:
    """Return what became of state equations; None where the states were not watched."""
    if ode is None:
        return None
    unread = physical.why_unread
    fails = f"the FMU fails where states are read ({unread}; --retry-failed asks again)"
    return EquationsFound(
        n_states=ode.n_states,
        n_calls=ode.n_asked,
        misfit=ode.misfit if np.isfinite(ode.misfit) else None,
        hidden_inputs=tuple(ode.hidden_inputs),
        error_at_best=ode.error_at_best if ode.is_believed else None,
        are_believed=ode.is_believed,
        why_not=None if ode.is_learnt else fails if unread else ode.why_not,
        without_effect=tuple(ode.without_effect),
        n_alone=ode.n_alone,
        is_given_up=ode.is_given_up,
    )
