"""How much of the paper is repeated: budgets, and the studies (window, seed, sizes) they are spent on."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from studies.profile import Profile
from studies.task import Task

HYPERPARAMETER_WINDOW_D = (8.0, 16.0)
"""Days of Fig. 6; everything else is done on the case's own window."""

FAITHFUL_PROFILE = "paper"
"""The profile with the networks as the paper describes them."""


@dataclass(frozen=True)
class PaperBudget:
    """How much is spent where the paper's profile leaves it open.

    Args:
        name: word for `--budget`.
        trials: trials by training-set size.
        faithful_trials: the same for the faithful form in Fig. 6.
        n_seeds: seeds of Table 4 at some sizes.
        seed_sizes: these sizes.
        max_row_calls: rows of Table 3 that took the paper more calls are left to another budget.
        n_starts: starts of Fig. 8.
        n_spread: rows of each of Fig. 7's test sets.
    """

    name: str
    trials: dict[int, int]
    faithful_trials: dict[int, int]
    n_seeds: int
    seed_sizes: tuple[int, ...]
    max_row_calls: int
    n_starts: int = 256
    n_spread: int = 320

    @property
    def n_train(self) -> tuple[int, ...]:
        """Training-set sizes."""
        return tuple(self.trials)


SMALL_SIZES, LARGE_SIZES = (32, 64, 128, 256, 512), (1024, 1536, 2048, 4096)
BUDGETS = {
    "small": PaperBudget(
        name="small",
        trials=dict.fromkeys((*SMALL_SIZES, 1024), 4),
        faithful_trials={},
        n_seeds=3,
        seed_sizes=(32, 64),
        max_row_calls=100_000,
    ),
    "full": PaperBudget(
        name="full",
        trials=dict.fromkeys(SMALL_SIZES, 40) | dict.fromkeys(LARGE_SIZES, 16),
        faithful_trials=dict.fromkeys(SMALL_SIZES, 16),
        n_seeds=10,
        seed_sizes=(32, 64, 128, 256),
        max_row_calls=2_000_000,
    ),
}


def budget_for(
    name: str, profile: Profile, *, own_profile: bool, trials: int | None, n_seeds: int | None
) -> PaperBudget:
    """Return a budget.

    Args:
        name: "small" or "full".
        profile: the profile the studies have.
        own_profile: whether the user named it: then sizes and trials are the profile's.
        trials: trials per size where the user named them.
        n_seeds: seeds of Table 4 where the user named them.
    """
    budget = BUDGETS[name]
    if own_profile:
        sizes, max_calls = profile.data.n_train, profile.polish.max_calls
        budget = replace(
            budget,
            trials=dict.fromkeys(sizes, profile.tuning.n_trials),
            faithful_trials={},
            seed_sizes=tuple(n for n in budget.seed_sizes if n in sizes) or sizes[:1],
            n_spread=profile.data.n_test,
            max_row_calls=min(budget.max_row_calls, 100 * max_calls),
            n_starts=min(budget.n_starts, max(2, max_calls // 5)),
        )
    if trials is not None:
        faithful = dict.fromkeys(budget.faithful_trials, trials)
        budget = replace(budget, trials=dict.fromkeys(budget.trials, trials), faithful_trials=faithful)
    return budget if n_seeds is None else replace(budget, n_seeds=n_seeds)


@dataclass(frozen=True)
class Plan:
    """What is repeated, and with how much.

    Args:
        opener: puts a study together, as the command line would, of `n_train` and, where they are given,
            `window`, `seed` and `profile`.
        budget: how much is spent.
        words: the words of the command line that name case, profile, seed and budget.
        trials: folder with the trials of Fig. 6 whose best are trained again; None takes this project's own.
    """

    opener: Callable[..., Task]
    budget: PaperBudget
    words: str
    trials: Path | None = None

    @cached_property
    def task(self) -> Task:
        """The study of the case's own window, which all results are named after."""
        return self.opener(n_train=self.budget.n_train)

    def hyperparameter_study(self) -> Task:
        """Return the study of Fig. 6, with all sizes."""
        return self.opener(window=HYPERPARAMETER_WINDOW_D, n_train=self.budget.n_train)

    def faithful_study(self) -> Task | None:
        """Return the study of the faithful form that Fig. 6 shows beside it, None where none is planned."""
        if not self.budget.faithful_trials:
            return None
        sizes = tuple(self.budget.faithful_trials)
        task = self.opener(window=HYPERPARAMETER_WINDOW_D, profile=FAITHFUL_PROFILE, n_train=sizes)
        tuning = replace(task.profile.tuning, baseline=False)
        return replace(task, profile=replace(task.profile, tuning=tuning))

    def seed_studies(self) -> tuple[Task, ...]:
        """Return the studies of Table 4: all sizes with the plan's seed, then some with each further seed."""
        first, sizes = self.task.profile.seed, self.budget.seed_sizes
        seeds = range(first + 1, first + self.budget.n_seeds)
        return (self.task, *(self.opener(seed=seed, n_train=sizes) for seed in seeds))

    def folder(self, item: str) -> Path:
        """Return where an item's files lie."""
        return self.task.results / "paper" / item

    def command(self, item: str) -> str:
        """Return what makes one item alone."""
        return f"studies reproduce-paper {self.words} --only {item}"
