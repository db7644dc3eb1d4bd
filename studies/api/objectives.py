"""`tune` with a user's objective: the trials of a function, with all that trials of surrogates have."""

import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from simulation.pool.pool_model import available_cores
from studies.api.verb import shown
from studies.keywords import typed
from studies.paths import ProjectPaths, find_project, mark_project
from studies.profile import ObjectiveProfile, load_objective_profile
from studies.results.objective import ObjectiveDeclaration, ObjectiveTrial, TunedObjective
from studies.tuning.attempts import places
from studies.tuning.live_trial import Objective
from studies.tuning.objectives import imported, source_of, tune_objective
from studies.tuning.sampler import make_pruner, make_sampler
from studies.words.wording import count, listed, significant

if TYPE_CHECKING:
    import pandas as pd
    from optuna.trial import FrozenTrial

SCHEMA = 1
"""Version of the records of trials."""
OF_A_CASE = ("n_train", "window", "simulations", "surrogate", "retry_failed", "dask")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, eq=False)
class ObjectiveResult:
    """What the trials of an objective came to.

    Attributes:
        paths: Where everything lies.
        tuned: The study with its trials.
    """

    paths: ProjectPaths
    tuned: TunedObjective

    @property
    def best(self) -> tuple[ObjectiveTrial, ...]:
        """The best trial; of several values those of the Pareto set, by the first value."""
        return self.tuned.best

    @cached_property
    def trials(self) -> "pd.DataFrame":
        """A row per trial: its number, state, parameters, values, constraints and duration in s."""
        import pandas as pd

        rows = [
            {"trial": t.number, "state": t.state, **t.params, **t.values, **t.constraints, "wall_s": t.wall_s}
            for t in self.tuned.trials
        ]
        return pd.DataFrame(rows).set_index("trial")


def tuned_by(
    objective: Objective | str, given: Mapping[str, Any], defaults: Mapping[str, Any]
) -> ObjectiveResult:
    """Tune with a user's objective, see `studies.tune`.

    Args:
        objective: The function, or "module:function".
        given: The keywords of `tune`.
        defaults: Their defaults.

    Raises:
        InputError: A keyword or a file is wrong, or no trial was completed.
        StageError: A worker failed.
    """
    began_s, console = time.monotonic(), shown(given["console"])
    for name in ("case", *OF_A_CASE):
        if given[name] != defaults[name]:
            word = name.replace("_", "-")
            raise InputError(f"{word} is of a case, and an objective has none; leave out one of the two")
    function = imported(objective) if isinstance(objective, str) else objective
    source = source_of(function)
    profile = given["profile"]
    budget = ObjectiveProfile() if profile == defaults["profile"] else load_objective_profile(str(profile))
    values, maximize = (
        _names("values", given["values"] or "value"),
        _names("maximize", given["maximize"] or ()),
    )
    if unknown := [name for name in maximize if name not in values]:
        raise InputError(f"maximize names {unknown[0]}, which is none of the values {listed(values)}")
    label = given["name"] or source["objective"].rpartition(".")[2].rpartition(":")[2]
    if not _NAME.fullmatch(label):
        raise InputError(f"{label!r} is no name of a study; give --name, letters, digits, '.', '_' and '-'")
    tuning, paths = budget.tuning, find_project(given["storage"], given["tracking"])
    seed = budget.seed if given["seed"] is None else given["seed"]
    n_trials, n_parallel = given["trials"] or tuning.n_trials, given["parallel"] or tuning.n_parallel
    make_sampler(tuning.sampler, seed)
    make_pruner(tuning.pruner)
    mark_project(paths, console)
    spec = ObjectiveDeclaration(
        label=label,
        sampler=tuning.sampler,
        pruner=tuning.pruner,
        seed=seed,
        values=values,
        maximize=maximize,
        enqueue=tuple(dict(point) for point in tuning.enqueue),
        max_trial_s=tuning.max_trial_s,
        note=budget.note,
        project=paths.identity if paths.storage is not None else "",
    )
    command = typed("tune", {**given, "case": "", "objective": source["objective"]}, defaults)
    what, max_hours = f"{count(n_trials, 'trial')} of {label}", given["max_hours"]
    with console.stage("tune", what), console.bars() as bars:

        def show(trials: "Sequence[FrozenTrial]") -> None:
            latest = places(trials)
            done = [one for one in latest if one.state.is_finished()]
            news = "" if len(values) > 1 else _best_so_far(done, spec)
            bars(label, len(done), max(n_trials, len(latest)), news)

        found = tune_objective(
            spec,
            function,
            paths=paths,
            n_trials=n_trials,
            n_jobs=given["jobs"] or max(available_cores(), n_parallel),
            n_parallel=n_parallel,
            until_s=None if max_hours is None else began_s + 3600.0 * max_hours,
            provenance={"schema": SCHEMA, "kind": "objective", "label": label, "command": command, **source},
            on_trials=show,
            on_warning=console.warn,
        )
    if max_hours is not None and found.n_ended < n_trials:
        console.say(
            f"tune: --max-hours ended it after {found.n_ended} of {n_trials} trials; the same command goes on"
        )
    elif not found.count("complete"):
        failed = next(
            (one.reason for one in found.trials if one.state == "failed" and one.reason), "all were pruned"
        )
        raise InputError(f"no trial of {found.spec.name} was completed ({failed}); MLflow has their reasons")
    return ObjectiveResult(paths, found)


def _names(keyword: str, given: str | Sequence[str]) -> tuple[str, ...]:
    names = (given,) if isinstance(given, str) else tuple(given)
    for name in names:
        if not _NAME.fullmatch(name):
            raise InputError(f"{keyword}: {name!r} is no name; give letters, digits, '.', '_' and '-'")
    if len({*names}) != len(names):
        raise InputError(f"{keyword} names one twice: {listed(names)}")
    return names


def _best_so_far(done: "Sequence[FrozenTrial]", spec: ObjectiveDeclaration) -> str:
    complete = [one.values[0] for one in done if one.state.name == "COMPLETE" and one.values]
    best = (max if spec.maximize else min)(complete, default=math.nan)
    return f": best {spec.values[0]} {significant(best)}" if complete else ""
