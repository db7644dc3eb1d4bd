"""Surrogates for the items: every size tuned a little first, then the sizes that get more trials."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from studies.paper.plan import trials_for
from studies.stages.learn import tune_stage
from studies.stages.pipeline import Outcome, Study
from studies.stages.simulate import simulate_stage


@dataclass(frozen=True)
class Tuned:
    """All sizes of a window, tuned.

    Args:
        study: the study, with all sizes.
        simulated: its simulations.
        by_size: what tuning came to, by size.
    """

    study: Study
    simulated: Outcome
    by_size: dict[int, dict[str, Any]]

    @property
    def wall_s(self) -> float:
        """Work behind it: simulating, and training of all trials. [s]."""
        return self.simulated.wall_s + sum(float(found["wall_s"]) for found in self.by_size.values())

    @property
    def n_simulations(self) -> dict[str, int]:
        """Rows of the sets, by purpose."""
        n = self.simulated.summary["n"]
        return {f"{name} set": int(n[name]) for name in ("train", "validation", "test")}

    def commands(self, trials: dict[int, int]) -> tuple[str, ...]:
        """Return the commands that do the same."""
        return tuple(
            f"studies tune {self.study.command} --n-train {' '.join(map(str, sizes))} --trials {n}"
            for n, sizes in _groups(tuple(self.by_size), trials).items()
        )


def tune_sizes(study: Study, trials: dict[int, int]) -> Tuned:
    """Simulate and tune all sizes of a study.

    Args:
        study: the study, with all sizes.
        trials: trials per size, see `trials_for`.
    """
    wanted = {size: trials_for(trials, size) for size in study.profile.data.n_train}
    simulated = simulate_stage(study)
    found: dict[int, dict[str, Any]] = {}
    # Breadth first: an interruption leaves something of every size.
    for n in sorted(set(wanted.values())):
        outcome = _tune(study, simulated, [size for size in wanted if wanted[size] >= n], n)
        found |= {int(one["n_train"]): one for one in outcome.summary["studies"]}
    return Tuned(study, simulated, found)


def _tune(study: Study, simulated: Outcome, sizes: Sequence[int], n_trials: int) -> Outcome:
    profile = study.profile
    profile = replace(
        profile,
        data=replace(profile.data, n_train=tuple(sizes)),
        tuning=replace(profile.tuning, n_trials=n_trials),
    )
    return tune_stage(replace(study, profile=profile), simulated)


def _groups(sizes: Sequence[int], trials: dict[int, int]) -> dict[int, tuple[int, ...]]:
    """Return the sizes by their number of trials, the most trials first."""
    wanted = {size: trials_for(trials, size) for size in sizes}
    return {
        n: tuple(size for size in sizes if wanted[size] == n)
        for n in sorted(set(wanted.values()), reverse=True)
    }
