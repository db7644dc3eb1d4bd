"""A run within a budget of simulations: training sets grow, and no simulation is made to judge alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from studies.results.outcome import Outcome, digest_of
from studies.results.stage_results import Calibration, Tuned
from studies.stages.calibrate_stage import calibrate_stage
from studies.stages.learn import tune_stage
from studies.stages.sensitivity_stage import surrogate_sensitivity_stage
from studies.stages.simulate_stage import simulate_stage
from studies.task import Task
from studies.words.wording import count, quantity, square_of

# Beside its polish a calibration asks for the screened point, and for its best row once more.
N_BESIDE = 2
# Errors of two sizes that differ by less are the same.
SAME_ERROR = 0.02


@dataclass(frozen=True)
class Spent:
    """What a run took of its budget.

    Attributes:
        budget: Simulations that it might take.
        used: Simulations that it took, those included that were stored before and those that were repeated.
        ended: Why it took no larger training set, in words.
    """

    budget: int
    used: int
    ended: str


def run_within_budget(task: Task, *, again: bool) -> tuple[tuple[Outcome[Any], ...], Spent]:
    """Tune, screen and polish with ever larger training sets, until two agree or the budget is spent.

    Each size but the last one polishes for as many calls as there are parameters at most, and leaves at least
    half of what is not yet planned; so its calibration is a look at what the size is worth, and its rows are
    known to the next one.

    Args:
        task: the task; its profile has a budget.
        again: repeat the calibrations if they are finished.

    Returns:
        What the stages came to, the report not among them; and what was spent.
    """
    budget, sizes = task.profile.budget.simulations, task.profile.data.n_train
    assert budget is not None, "the profile has one"
    p = task.case.parameter_space.n_parameters
    # The calibrated point is also simulated over the validation period, where there is one.
    n_validated = 0 if task.case.validation is None else 1
    simulated, tuned, calibrated = list[Outcome[Any]](), list[Outcome[Tuned]](), list[Outcome[Calibration]]()
    polished, ended = 0, f"n_train = {sizes[-1]} is the largest that the budget allows"
    for n_train, larger in zip(sizes, (*sizes[1:], None), strict=True):
        left = budget - n_train - polished
        if larger is not None:
            left = min(p, (left - (larger - n_train)) // 2)
        part = _of_size(task, n_train, left - N_BESIDE - n_validated)
        simulated.append(simulate_stage(part))
        tuned.append(tune_stage(part, simulated[-1]))
        calibrated.append(calibrate_stage(part, n_train, again=again))
        found = calibrated[-1].result
        polished += found.ledger["n_screen_checks"] + found.ledger["n_polish"]
        polished += found.n_repeated + n_validated
        if larger is not None and (reason := _is_enough(task, [one.result for one in calibrated])):
            ended = reason
            break
    used = n_train + polished
    task.console.say(f"{used} of {count(budget, 'simulation')} used: {ended}")
    stages = (*simulated, _joined(tuned), surrogate_sensitivity_stage(task, n_train), *calibrated)
    return stages, Spent(budget, used, ended)


def _of_size(task: Task, n_train: int, n_calls: int) -> Task:
    """Return the task of one size, whose calibration may ask for so many simulations."""
    profile = task.profile
    polish, data = replace(profile.polish, max_calls=n_calls), replace(profile.data, n_train=(n_train,))
    return replace(task, profile=replace(profile, data=data, polish=polish))


def _is_enough(task: Task, found: Sequence[Calibration]) -> str:
    """Say why no larger training set is simulated, "" if one is."""
    last, unit = found[-1], square_of(task.case.outputs[0].unit)
    sensor = float(task.case.measurement.uncertainty[0])
    if last.converged and last.mse <= sensor**2:
        return f"{last.error_name} {quantity(last.mse, unit)} is within the sensor's uncertainty"
    if len(found) > 1 and last.converged and abs(last.mse - found[-2].mse) <= SAME_ERROR * found[-2].mse:
        return f"n_train = {found[-2].n_train} and {last.n_train} lead to the same error"
    return ""


def _joined(tuned: Sequence[Outcome[Tuned]]) -> Outcome[Tuned]:
    """Return the tuning of all sizes as one outcome."""
    return Outcome(
        "tune",
        Tuned(tuple(size for one in tuned for size in one.result.studies)),
        digest_of({"tuned": [one.digest for one in tuned]}),
        reused=all(one.reused for one in tuned),
        wall_s=sum(one.wall_s for one in tuned),
    )
