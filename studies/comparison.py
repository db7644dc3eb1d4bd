"""Two profiles or labels side by side: the best trial of each training-set size, and which is better."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from statistics import fmean, stdev
from typing import Any

from scipy.stats import ttest_ind_from_stats

from simulation.errors import InputError
from studies.blocks import Block, Column, Table, number
from studies.profile import load_profile
from studies.project import Project
from studies.results.outcome import read_outcome
from studies.results.stage_results import SimulatedSets
from studies.results.trials import TrialView, TunedStudy
from studies.tuning.study_results import latest_studies
from studies.words.wording import MISSING, difference_unit, significant

SURE = 0.05
"""Largest probability of a difference from noise alone (Welch's t-test) at which one is called better."""


@dataclass(frozen=True)
class ComparedStudy:
    """What one of the two came to at a training-set size.

    Attributes:
        study: Name of the Optuna study of its best trial.
        trial: Number of its best trial.
        params: Hyperparameters of that trial.
        mae: Validation MAE of these, the mean of further seeds where they were confirmed. [unit]
        mae_deviation: Standard deviation from seed to seed; None where they were not confirmed. [unit]
        p90: 90th percentile of the absolute validation errors, likewise. [unit]
        p90_deviation: Its standard deviation from seed to seed; None where they were not confirmed. [unit]
        n_seeds: Trainings behind each number: 1 where they were not confirmed.
        n_trials: Trials that have ended.
        n_simulations: Simulations of training, validation and test set; None where that is not recorded.
    """

    study: str
    trial: int
    params: dict[str, Any]
    mae: float
    mae_deviation: float | None
    p90: float | None
    p90_deviation: float | None
    n_seeds: int
    n_trials: int
    n_simulations: int | None


@dataclass(frozen=True)
class ComparedSize:
    """Two labels at one training-set size.

    Attributes:
        n_train: The size.
        unit: Of the errors.
        first: What the first label came to; None without a complete trial.
        second: What the second label came to; None likewise.
        better: The label that is better beyond the noise; "" where that is not known, or neither is.
        verdict: Which label is better, in words.
    """

    n_train: int
    unit: str
    first: ComparedStudy | None
    second: ComparedStudy | None
    better: str
    verdict: str


def label_called(project: Project, name: str) -> str:
    """Return the label that a label, a pattern, a case or a profile means.

    Raises:
        InputError: none is called so, or several are.
    """
    wanted = load_profile(name).name if name.endswith(".toml") else name
    cases = {one.spec.label: one.spec.case_name for one in project.studies}
    if wanted in cases:
        return wanted
    called = [
        label
        for label, case in sorted(cases.items())
        if fnmatchcase(label, wanted) or wanted in (case, label.removeprefix(f"{case}-"))
    ]
    if not called:
        raise InputError(f"nothing is called {name!r}; labels: {', '.join(sorted(cases)) or 'none'}")
    if len(called) > 1:
        raise InputError(f"{name!r} may be {', '.join(called)}; give one of these labels")
    return called[0]


def compared_sizes(project: Project, labels: tuple[str, str]) -> list[ComparedSize]:
    """Compare the studies of two labels, size by size."""
    first, second = (
        {n: one for (n, is_baseline), one in latest_studies(found).items() if not is_baseline}
        for found in ([one for one in project.studies if one.spec.label == label] for label in labels)
    )
    return [
        _compared(project, n, labels, (first.get(n), second.get(n)))
        for n in sorted(first.keys() | second.keys())
    ]


def _compared(
    project: Project,
    n_train: int,
    labels: tuple[str, str],
    found: tuple[TunedStudy | None, TunedStudy | None],
) -> ComparedSize:
    there = [one for one in found if one is not None and one.best_trial is not None]
    first, second = (_study(project, one) for one in found)
    unit = difference_unit(next(one.spec.output_unit for one in found if one is not None))
    if len(there) < 2:
        return ComparedSize(n_train, unit, first, second, "", "one label has no complete trial")
    better, verdict = _verdict(labels, there[0], there[1])
    return ComparedSize(n_train, unit, first, second, better, verdict)


def _study(project: Project, found: TunedStudy | None) -> ComparedStudy | None:
    if found is None or (best := found.best_trial) is None:
        return None
    seeds = _seeds(found)
    errors = [[one.metrics[f"{one.spec.chosen_by}/{name}"] for one in seeds] for name in ("mae", "p90")]
    (mae, mae_deviation), (p90, p90_deviation) = (
        (fmean(values), stdev(values) if len(values) > 1 else None) for values in errors
    )
    sets = read_outcome(project.paths.results(found.spec.label), "simulate", SimulatedSets)
    others = {} if sets is None else {name: n for name, n in sets.result.n.items() if name != "train"}
    return ComparedStudy(
        study=best.spec.name,
        trial=best.number,
        params=dict(best.params),
        mae=mae,
        mae_deviation=mae_deviation,
        p90=p90,
        p90_deviation=p90_deviation,
        n_seeds=len(seeds),
        n_trials=found.n_ended,
        n_simulations=None if sets is None else found.spec.n_train + sum(others.values()),
    )


def _seeds(found: TunedStudy) -> list[TrialView]:
    """Return trainings of the best settings with further seeds, none of which was chosen; else the trial."""
    best = found.best_trial
    assert best is not None, "looked for before"
    seeds = [one for one in found.usable if one.spec.is_confirmation and one.settings == best.settings]
    return seeds if len(seeds) > 1 else [best]


def _verdict(labels: tuple[str, str], first: TunedStudy, second: TunedStudy) -> tuple[str, str]:
    judged = [
        (
            one.spec.digests["train" if one.spec.folds else "validation"],
            one.spec.output_scales,
            one.spec.folds,
        )
        for one in (first, second)
    ]
    if judged[0] != judged[1]:
        return "", "not known: other rows judge"
    a, b = ([one.value or 0.0 for one in _seeds(study)] for study in (first, second))
    if min(len(a), len(b)) < 2:
        alone = "one seed each" if max(len(a), len(b)) < 2 else f"one seed of {labels[len(a) > 1]}"
        return "", f"not known: {alone}"
    difference, is_noisy = fmean(a) - fmean(b), stdev(a) + stdev(b) > 0.0
    both = fmean(a), stdev(a), len(a), fmean(b), stdev(b), len(b)
    p = float(ttest_ind_from_stats(*both, equal_var=False).pvalue) if is_noisy else float(difference == 0.0)
    if p >= SURE:
        return "", "no difference beyond the noise"
    better = labels[difference > 0.0]
    return better, f"{better} is better by {significant(abs(difference), 2)}, p = {significant(p, 1)}"


def compare_blocks(labels: tuple[str, str], sizes: Sequence[ComparedSize]) -> list[Block]:
    """Return what a person sees."""
    columns = [number("n_train"), Column("label"), number("MAE"), number("P90"), number("seeds", spare=2)]
    columns += [number("trials", spare=3), number("simulations", spare=4), Column("which is better")]
    rows = [
        [
            size.n_train if is_first else "",
            label,
            *(
                [MISSING] * 5
                if one is None
                else [
                    _with_deviation(one.mae, one.mae_deviation),
                    _with_deviation(one.p90, one.p90_deviation),
                    one.n_seeds,
                    one.n_trials,
                    MISSING if one.n_simulations is None else one.n_simulations,
                ]
            ),
            size.verdict if is_first else "",
        ]
        for size in sizes
        for is_first, label, one in ((True, labels[0], size.first), (False, labels[1], size.second))
    ]
    units = {one.unit for one in sizes}
    unit = f", in {units.pop()}" if len(units) == 1 else ""
    return [
        Table(f"Best trial of each size (errors on the validation rows{unit}; ± seed to seed)", columns, rows)
    ]


def _with_deviation(value: float | None, deviation: float | None) -> str:
    return significant(value) if deviation is None else f"{significant(value)} ± {significant(deviation, 2)}"


def compare_document(labels: tuple[str, str], sizes: Sequence[ComparedSize]) -> dict[str, Any]:
    """Return what a program reads."""
    both = {"first": labels[0], "second": labels[1]}
    return {"command": "compare", **both, "sizes": [asdict(one) for one in sizes]}
