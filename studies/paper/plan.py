"""How much of the paper is repeated: budgets, and the studies (window, seed, sizes) they are spent on."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from simulation.errors import InputError, MachineError
from studies.profile import Profile
from studies.stages.pipeline import Study

BudgetName = Literal["small", "full"]
Window = tuple[float, float] | None

HYPERPARAMETER_WINDOW_D = (8.0, 16.0)
"""Days of Fig. 6; everything else is done on the case's own window."""

FAITHFUL_PROFILE = "paper"
"""The profile with the networks as the paper describes them."""

# Processor seconds of one training to its end, measured; pruned trials end sooner.
TRAINING_S = {32: 2.5, 128: 4.5, 256: 7.5, 1024: 30.0, 4096: 115.0}
FAITHFUL_TRAINING_S = {32: 10.0, 128: 14.0, 256: 22.0, 1024: 95.0, 4096: 370.0}
SIMULATIONS_PER_S = 1_500.0
DIRECT_CALLS_PER_S = 2_000.0
PREDICTIONS_PER_S = 4_500.0


@dataclass(frozen=True)
class PaperBudget:
    """How much is spent where the paper's profile leaves it open.

    Args:
        name: word for `--budget`.
        note: what a reader of the results must know.
        n_train: training-set sizes.
        trials: trials per size; a size that is not named gets those of the next larger one.
        faithful_trials: the same for the faithful form in Fig. 6; sizes above the largest have none.
        n_base: Saltelli blocks of the Sobol indices.
        n_resamples: their bootstrap samples.
        n_seeds: seeds of Table 4 at some sizes, the first among them, and of Table 3 beside the first.
        seed_sizes: training-set sizes of Table 4 with several seeds.
        white_box_trials: trials per size of the white box, at the same sizes.
        max_row_calls: rows of Table 3 that took the paper more calls are left to another budget.
        max_seeded_calls: the same for rows that are repeated with other seeds.
        max_starts: most starts of Fig. 8.
        n_spread: rows of each of Fig. 7's test sets.
    """

    name: str
    note: str
    n_train: tuple[int, ...]
    trials: dict[int, int]
    faithful_trials: dict[int, int]
    n_base: int
    n_resamples: int
    n_seeds: int
    seed_sizes: tuple[int, ...]
    white_box_trials: int
    max_row_calls: int
    max_seeded_calls: int
    max_starts: int
    n_spread: int = 320

    def to_dict(self) -> dict[str, Any]:
        """Return the budget as JSON values."""
        return asdict(self)


BUDGETS: dict[str, PaperBudget] = {
    "small": PaperBudget(
        name="small",
        note="Small budget: training sets up to 1,024, four trials per size, one seed, three seeds for the "
        "robust statistics. It shows the shape of the results; --budget full has the paper's sizes.",
        n_train=(32, 64, 128, 256, 512, 1024),
        trials={4096: 4},
        faithful_trials={},
        n_base=4096,
        n_resamples=100,
        n_seeds=3,
        seed_sizes=(32, 64),
        white_box_trials=2,
        max_row_calls=100_000,
        max_seeded_calls=20_000,
        max_starts=256,
    ),
    "full": PaperBudget(
        name="full",
        note="Full budget: all training-set sizes of the paper, fewer trials for the larger ones, ten seeds "
        "for the robust statistics.",
        n_train=(32, 64, 128, 256, 512, 1024, 1536, 2048, 4096),
        trials={512: 40, 4096: 16},
        faithful_trials={512: 16},
        n_base=32_768,
        n_resamples=200,
        n_seeds=10,
        seed_sizes=(32, 64, 128, 256),
        white_box_trials=4,
        max_row_calls=2_000_000,
        max_seeded_calls=100_000,
        max_starts=256,
    ),
}


def budget_for(
    name: str, profile: Profile, *, own_profile: bool, trials: int | None, n_seeds: int | None = None
) -> PaperBudget:
    """Return a budget.

    Args:
        name: "small" or "full".
        profile: the profile the studies have.
        own_profile: whether the user named it: then sizes, trials and Saltelli blocks are the profile's.
        trials: trials per size where the user named them.
        n_seeds: seeds of the robust statistics where the user named them.
    """
    if name not in BUDGETS:
        raise InputError(f"--budget {name}: there is no such budget; give {' or '.join(BUDGETS)}")
    budget = BUDGETS[name]
    if own_profile:
        sizes, every = profile.data.n_train, {max(profile.data.n_train): profile.tuning.n_trials}
        budget = replace(
            budget,
            note=f"{profile.note} Sizes, trials and Saltelli blocks are those of the profile "
            f"{profile.name}.".strip(),
            n_train=sizes,
            trials=every,
            faithful_trials={},
            n_base=profile.sensitivity.n_base,
            n_resamples=profile.sensitivity.n_resamples,
            seed_sizes=tuple(n for n in budget.seed_sizes if n in sizes) or sizes[:1],
            white_box_trials=min(budget.white_box_trials, profile.tuning.n_trials),
            n_spread=profile.data.n_test,
            max_row_calls=min(budget.max_row_calls, 100 * profile.polish.max_calls),
            max_seeded_calls=min(budget.max_seeded_calls, 100 * profile.polish.max_calls),
            max_starts=min(budget.max_starts, max(2, profile.polish.max_calls // 5)),
        )
    if trials is not None:
        every = {max(budget.n_train): trials}
        note = f"{budget.note} Trials: {trials} per size, not the budget's."
        faithful = {max(budget.faithful_trials): trials} if budget.faithful_trials else {}
        budget = replace(budget, note=note, trials=every, faithful_trials=faithful)
    return budget if n_seeds is None else replace(budget, n_seeds=n_seeds)


def trials_for(trials: dict[int, int], n_train: int) -> int:
    """Return the trials of a size: those of the next larger size that is named."""
    named = [size for size in sorted(trials) if size >= n_train]
    return trials[named[0]] if named else trials[max(trials)]


class StudyOpener(Protocol):
    """Puts a study together as the command line would from the same words."""

    def __call__(
        self,
        *,
        case: str | None = None,
        window: Window = None,
        seed: int | None = None,
        profile: str | None = None,
        n_train: tuple[int, ...],
        trials: int,
    ) -> Study:
        """Return the study of a case, window, seed and profile (None: the one asked for), and sizes."""


@dataclass(frozen=True)
class Plan:
    """What is repeated, and with how much.

    Args:
        opener: puts a study together.
        budget: how much is spent.
        words: the words of the command line that name case, profile, seed and budget.
        trials: folder with the trials of Fig. 6 whose best are trained again; None takes this project's own.
    """

    opener: StudyOpener
    budget: PaperBudget
    words: str
    trials: Path | None = None

    @cached_property
    def study(self) -> Study:
        """The study of the case's own window, which all results are named after."""
        return self.opener(n_train=self.budget.n_train, trials=min(self.budget.trials.values()))

    def hyperparameter_study(self) -> Study:
        """Return the study of Fig. 6, with all sizes."""
        return self._fig6_study(None, self.budget.n_train, self.budget.trials)

    def faithful_study(self) -> Study:
        """Return the study of the faithful form that Fig. 6 shows beside it, without PCA + GP."""
        trials = self.budget.faithful_trials
        study = self._fig6_study(FAITHFUL_PROFILE, self.faithful_sizes, trials)
        tuning = replace(study.profile.tuning, baseline=False)
        return replace(study, profile=replace(study.profile, tuning=tuning))

    @property
    def faithful_sizes(self) -> tuple[int, ...]:
        """Training-set sizes at which Fig. 6 shows the faithful form."""
        return tuple(n for n in self.budget.n_train if n <= max(self.budget.faithful_trials, default=0))

    def _fig6_study(self, profile: str | None, n_train: tuple[int, ...], every: dict[int, int]) -> Study:
        """Return the study of Fig. 6's window, or the case's own where the recording does not hold it."""
        trials = min(every.values())
        try:
            return self.opener(
                window=HYPERPARAMETER_WINDOW_D, profile=profile, n_train=n_train, trials=trials
            )
        except MachineError:
            raise
        except InputError as error:
            # Nobody typed this window: what the case says of it, without the option's name.
            why = error.__cause__ or error
            self.study.console.say(f"fig6: days 8 to 16 cannot be had ({why}); the case's own window is used")
            return self.opener(profile=profile, n_train=n_train, trials=trials)

    def other_study(self, case: str) -> Study:
        """Return the study of another case, with the sizes that have several seeds in Table 4."""
        return self.opener(case=case, n_train=self.budget.seed_sizes, trials=self.budget.white_box_trials)

    def seed_study(self, seed: int) -> Study:
        """Return the study of another seed, with the sizes that have several."""
        return self.opener(seed=seed, n_train=self.budget.seed_sizes, trials=1)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds after the plan's own, as many as the budget says."""
        first = self.study.profile.seed
        return tuple(range(first + 1, first + 1 + self.budget.n_seeds))

    @property
    def more_seeds(self) -> tuple[int, ...]:
        """Seeds of Table 4 beside the plan's own."""
        return self.seeds[:-1]

    def seeds_of(self, n_train: int) -> tuple[int, ...]:
        """Return the seeds of a size in Table 4, the plan's own first."""
        return (self.study.profile.seed, *(self.more_seeds if n_train in self.budget.seed_sizes else ()))

    def command(self, item: str) -> str:
        """Return what makes one item alone."""
        return f"studies reproduce-paper {self.words} --only {item}".replace("  ", " ")

    def training_s(
        self, sizes: tuple[int, ...], trials: dict[int, int], one_s: Mapping[int, float] = TRAINING_S
    ) -> float:
        """Estimate how long tuning takes. [s].

        Args:
            sizes: training-set sizes.
            trials: trials per size.
            one_s: duration of one training, by size. [s]
        """
        work = self.trainings_s([n for n in sizes for _ in range(trials_for(trials, n))], one_s)
        return work / min(self.study.n_jobs, len(sizes)) + 10.0

    def trainings_s(self, sizes: Sequence[int], one_s: Mapping[int, float] = TRAINING_S) -> float:
        """Estimate how long trainings take one after another. [s].

        Args:
            sizes: training-set size of each.
            one_s: duration of one, by size. [s]
        """
        known = sorted(one_s)
        return float(np.interp(np.log(sizes), np.log(known), [one_s[n] for n in known]).sum())

    def screening_s(self) -> float:
        """Estimate how long one calibration takes. [s]."""
        budget, p = self.study.profile.screening, self.study.case.parameter_space.n_parameters
        population = 1 << (max(5, budget.popsize * p) - 1).bit_length()
        return population * (budget.maxiter + 1) / PREDICTIONS_PER_S + 5.0
