"""`tune` with a user's objective: the trials of a function, with all that trials of surrogates have."""

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
from studies.results.objective import ObjectiveDeclaration, TunedObjective
from studies.tuning.live_trial import Objective
from studies.tuning.objectives import imported, source_of, tune_objective
from studies.words.wording import count

if TYPE_CHECKING:
    import pandas as pd

OF_A_CASE = ("case", "n_train", "window", "simulations", "surrogate", "retry_failed", "dask")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, eq=False)
class ObjectiveResult:
    """What the trials of an objective came to.

    Attributes:
        paths: Where everything lies.
        tuned: The study; its `best` are trials as Optuna has them, one or the Pareto set.
    """

    paths: ProjectPaths
    tuned: TunedObjective

    @cached_property
    def trials(self) -> "pd.DataFrame":
        """A row per trial: state, parameters, values, constraints, MLflow's run, duration in s."""
        import pandas as pd

        return pd.json_normalize([self.tuned.row(one) for one in self.tuned.trials]).set_index("trial")


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
    began_s, console, hours = time.monotonic(), shown(given["console"]), given["max_hours"]
    if wrong := next((name for name in OF_A_CASE if given[name] != defaults[name]), None):
        raise InputError(f"{wrong} = {given[wrong]} is of a case; leave it out, or leave out the objective")
    function = imported(objective) if isinstance(objective, str) else objective
    source, profile = source_of(function), ObjectiveProfile()
    if given["profile"] != defaults["profile"]:
        profile = load_objective_profile(str(given["profile"]))
    label = given["name"] or re.split("[.:]", source["objective"])[-1]
    values = _names("values", given["values"] or "value")
    maximize, _ = _names("maximize", given["maximize"] or ()), _names("name", label)
    if wrong := next((name for name in maximize if name not in values), None):
        raise InputError(f"maximize: {wrong} is none of the values {', '.join(values)}")
    tuning, paths = profile.tuning, find_project(given["storage"], given["tracking"])
    mark_project(paths, console)
    n_trials, n_parallel = given["trials"] or tuning.n_trials, given["parallel"] or tuning.n_parallel
    spec = ObjectiveDeclaration(
        label=label,
        sampler=tuning.sampler,
        pruner=tuning.pruner,
        seed=profile.seed if given["seed"] is None else given["seed"],
        values=values,
        maximize=maximize,
        enqueue=tuple(dict(point) for point in tuning.enqueue),
        max_trial_s=tuning.max_trial_s,
        note=profile.note,
        project=paths.identity if paths.storage is not None else "",
    )
    command = typed("tune", {**given, "case": "", "objective": source["objective"]}, defaults)
    with console.stage("tune", f"{count(n_trials, 'trial')} of {label}"), console.bars() as bars:
        found = tune_objective(
            spec,
            function,
            paths=paths,
            n_trials=n_trials,
            n_jobs=given["jobs"] or max(available_cores(), n_parallel),
            n_parallel=n_parallel,
            until_s=None if hours is None else began_s + 3600.0 * hours,
            provenance={"kind": "objective", "command": command, **source},
            on_poll=lambda now: bars(label, now.n_ended, now.n_planned),
            on_warning=console.warn,
        )
    if hours is not None and found.n_ended < n_trials:
        console.say(
            f"tune: --max-hours ended it after {found.n_ended} of {n_trials} trials; the same command goes on"
        )
    elif not found.count("complete", "running"):
        said = next((found.row(one)["reason"] for one in found.trials if one.state.name == "FAIL"), "pruned")
        raise InputError(
            f"no trial of {found.spec.name} was completed; the first: {said}; MLflow has the others"
        )
    return ObjectiveResult(paths, found)


def _names(keyword: str, given: str | Sequence[str]) -> tuple[str, ...]:
    names = (given,) if isinstance(given, str) else tuple(given)
    wrong = [name for name in names if not _NAME.fullmatch(name) or names.count(name) > 1]
    if wrong:
        raise InputError(
            f"{keyword}: {wrong[0]!r}: give each once, a letter and then letters, digits, '.', '_', '-'"
        )
    return names
