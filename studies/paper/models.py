"""The surrogates of Fig. 7 and Table 4: the best of each size in Fig. 6, trained once more on other data."""

from dataclasses import dataclass, replace

from simulation.errors import InputError
from studies.paper.fig6 import SizeTrials
from studies.paper.items import read_sizes
from studies.paper.plan import Plan
from studies.search_space import SearchParameter, Value
from studies.stages.learn import tune_stage
from studies.stages.simulate_stage import simulate_stage
from studies.task import Task

Settings = dict[str, Value]


@dataclass(frozen=True)
class Chosen:
    """What Fig. 6 chose for a training-set size: the best trial by validation error.

    Args:
        n_train: training-set size.
        surrogate: form of the surrogate.
        settings: its hyperparameters, tuned for Fig. 6.
        tuned_on_d: first and last day of that. [d]
    """

    n_train: int
    surrogate: str
    settings: Settings
    tuned_on_d: tuple[float, float]


def chosen_settings(plan: Plan) -> dict[int, Chosen]:
    """Return what Fig. 6 chose for each of the plan's sizes.

    Raises:
        InputError: there are no trials of a size, or they are those of another form of the surrogate.
    """
    folder, wanted = plan.trials or plan.folder("fig6"), plan.task.profile.tuning.surrogate
    origin, sizes = read_sizes(folder, SizeTrials)
    tunings = {size.n_train: size.networks for size in sizes}
    for n in plan.budget.n_train:
        if n not in tunings:
            raise InputError(f"{folder} holds no trials of n_train = {n}; tune it, or name another --profile")
        if tunings[n].surrogate != wanted:
            raise InputError(
                f"{folder} holds trials of surrogate {tunings[n].surrogate!r}, the profile asks for "
                f"{wanted!r}; name a profile with --profile"
            )
    days = origin.window_d
    return {n: Chosen(n, wanted, dict(tunings[n].best.params), days) for n in plan.budget.n_train}


def train_again(task: Task, n_train: int, settings: Settings) -> tuple[Task, float]:
    """Simulate a study's sets and train the surrogate of one of its sizes, with all epochs.

    Args:
        task: the study, with all sizes.
        n_train: training-set size.
        settings: hyperparameters.

    Returns:
        The study of these surrogates, with a label and results of its own; the training time [s].
    """
    task = replace(task, label=f"{task.label}-fig6")
    simulated = simulate_stage(task)
    # The study of one size whose only trial has these hyperparameters.
    profile = task.profile
    search = {name: SearchParameter("categorical", choices=(value,)) for name, value in settings.items()}
    tuning = replace(profile.tuning, n_trials=1, search=search, enqueue=(), baseline=False)
    one_size = replace(profile, data=replace(profile.data, n_train=(n_train,)), tuning=tuning)
    (found,) = tune_stage(replace(task, profile=one_size), simulated).result.studies
    return task, found.wall_s
