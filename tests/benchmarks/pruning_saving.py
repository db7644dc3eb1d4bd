"""What a pruner saves and what it loses, on real learning curves of the office.

Run `python tests/benchmarks/pruning_saving.py FILE [--live 64]`; FILE comes from trained_trials.py. Each rule
is replayed over trials that were trained to their end: the five studies in their own order, and forty random
orders of the random trials, all beginning with the default. `epochs` is the part of the epochs that is
trained, `time` the same weighted with each trial's processor time, `lost` how much the best validation MAE
that is left lies above the best of all, on average and at most. A replay cannot know that the search would
have gone elsewhere; --live runs whole studies with and without pruning.
"""

import argparse
import statistics
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
from optuna.trial import Trial, create_trial
from optuna.trial import TrialState as OptunaState
from trained_trials import RANDOM, Trained, as_record, office_spec, read, train

from studies.tuning.pruning import Pruner
from studies.tuning.search_space import proposal_of, propose
from studies.tuning.study_data import load_data
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_training import report_epochs

LENGTHS, N_ORDERS = (8, 20, 40), 40
P = optuna.pruners
LIBRARY: dict[str, Callable[[], optuna.pruners.BasePruner]] = {
    "median after 1": lambda: P.MedianPruner(n_startup_trials=1),
    "median after 1, from 40 %": lambda: P.MedianPruner(n_startup_trials=1, n_warmup_steps=159),
    "percentile 25 after 4": lambda: P.PercentilePruner(25.0, n_startup_trials=4),
    "percentile 25 after 2, from 25 %": lambda: P.PercentilePruner(
        25.0, n_startup_trials=2, n_warmup_steps=99
    ),
    "halving from 10 %": lambda: P.SuccessiveHalvingPruner(min_resource=40, reduction_factor=2),
    "halving from 25 %": lambda: P.SuccessiveHalvingPruner(min_resource=100, reduction_factor=2),
    "Hyperband": lambda: P.HyperbandPruner(min_resource=40, max_resource=400, reduction_factor=3),
    "Wilcoxon 0.1": lambda: P.WilcoxonPruner(p_threshold=0.1),
    "patient median": lambda: P.PatientPruner(P.MedianPruner(n_startup_trials=1), patience=2),
}

Rule = Callable[[Sequence[Trained]], list[int]]


def compared(trained: Trained) -> list[tuple[int, int, float]]:
    """Return place in the curve, epoch of comparison and error wherever a running trial is compared."""
    found: dict[int, tuple[int, int, float]] = {}
    steps = report_epochs(400)
    for place, (epoch, value) in enumerate(zip(trained.epochs, trained.curve, strict=True)):
        due = [step for step in steps if step <= epoch]
        if due and due[-1] not in found:
            found[due[-1]] = (place, due[-1], value)
    return list(found.values())


def library(make: Callable[[], optuna.pruners.BasePruner]) -> Rule:
    """Return a rule of Optuna's."""

    def validations(order: Sequence[Trained]) -> list[int]:
        study, found = optuna.create_study(pruner=make()), []
        for trained in order:
            study.add_trial(create_trial(state=OptunaState.RUNNING))
            trial = Trial(study, study.get_trials(deepcopy=False)[-1]._trial_id)
            n = len(trained.curve)
            for place, step, value in compared(trained):
                trial.report(value, step)
                if place + 1 < n and trial.should_prune():
                    study.tell(trial.number, state=OptunaState.PRUNED)
                    n = place + 1
                    break
            else:
                study.tell(trial.number, min(trained.curve))
            found.append(n)
        return found

    return validations


def own(spec: StudySpec) -> Rule:
    """Return the rule of a study."""

    def validations(order: Sequence[Trained]) -> list[int]:
        records: list[TrialRecord] = []
        found = []
        for index, trained in enumerate(order):
            pruner, n = Pruner(spec, records), len(trained.curve)
            for place, step, value in compared(trained):
                if place + 1 < n and pruner.is_hopeless(step, value):
                    n = place + 1
                    break
            proposal = proposal_of(spec, index, trained.params, origin="")
            whole = n == len(trained.curve)
            record = as_record(spec, trained, proposal, state="complete" if whole else "pruned")
            reports = {str(step): value for place, step, value in compared(trained) if place < n}
            records.append(replace(record, reports=reports))
            found.append(n)
        return found

    return validations


def orders(trials: Sequence[Trained], n: int) -> dict[str, list[list[Trained]]]:
    """Return the orders in which n trials are replayed, by their kind."""
    whole = [one for one in trials if one.metrics]
    seeds = sorted({one.seed for one in whole} - {RANDOM})
    studies = [[one for one in whole if one.seed == seed][:n] for seed in seeds]
    pool = [one for one in whole if one.seed == RANDOM]
    rng = np.random.default_rng(0)
    drawn = [
        [studies[0][0], *(pool[place] for place in rng.choice(len(pool), n - 1, replace=False))]
        for _ in range(N_ORDERS if len(pool) >= n else 0)
    ]
    return {"studies": [one for one in studies if len(one) == n], "random": drawn}


def replay(trials: Sequence[Trained], spec: StudySpec) -> None:
    """Print what each rule saves and loses."""
    rules = {name: library(make) for name, make in LIBRARY.items()}
    rules |= {name: own(replace(spec, pruner=name)) for name in ("median", "catch-up")}
    for n in LENGTHS:
        for kind, found in orders(trials, n).items():
            if not found:
                continue
            print(f"\nn_train {spec.n_train}, {n} trials, {kind} ({len(found)} orders)")
            for name, rule in rules.items():
                epochs, seconds, lost = [], [], []
                for order in found:
                    parts = [n / len(one.curve) for one, n in zip(order, rule(order), strict=True)]
                    epochs.append(statistics.fmean(parts))
                    whole = sum(one.cpu_s for one in order)
                    trained = (one.cpu_s * part for one, part in zip(order, parts, strict=True))
                    seconds.append(sum(trained) / whole)
                    best = min(one.metrics["val/mae"] for one in order)
                    kept = (one.metrics["val/mae"] for one, p in zip(order, parts, strict=True) if p == 1.0)
                    lost.append(100.0 * (min(kept) / best - 1.0))
                print(
                    f"  {name:34s} epochs {statistics.fmean(epochs):.2f}"
                    f"  time {statistics.fmean(seconds):.2f}"
                    f"  lost {statistics.fmean(lost):.2f} % (most {max(lost):.1f} %)"
                )


def live(
    spec: StudySpec, trials: Sequence[Trained], seeds: Sequence[int], n_trials: int, pruners: Sequence[str]
) -> None:
    """Run whole studies with each pruner, and print epochs trained and the best error of each.

    Args:
        spec: The study.
        trials: Trained trials; the studies among them are those without pruning.
        seeds: Of the studies.
        n_trials: Of each study.
        pruners: Rules to compare.
    """
    data = load_data(spec)
    print(f"\nn_train {spec.n_train}, whole studies of {n_trials} trials, seeds {list(seeds)}")
    unpruned = [[one for one in trials if one.seed == seed][:n_trials] for seed in seeds]
    best = [min(one.metrics["val/mae"] for one in study if one.metrics) for study in unpruned]
    seconds = [sum(one.cpu_s for one in study) for study in unpruned]
    report("none", [1.0] * len(seeds), seconds, best)
    for name in pruners:
        best, epochs, seconds = [], [], []
        for seed in seeds:
            study = replace(spec, seed=seed, pruner=name)
            records: list[TrialRecord] = []
            seconds.append(0.0)
            for index in range(n_trials):
                proposal = propose(study, index, records)
                pruner = Pruner(study, records)
                trained, outcome = train(study, proposal, data, index, pruner.is_hopeless)
                record = as_record(study, trained, proposal, state=outcome.state)
                records.append(replace(record, reports=outcome.reports))
                seconds[-1] += trained.cpu_s
            epochs.append(sum(record.n_epochs for record in records) / n_trials / 400)
            best.append(min(one.metrics["val/mae"] for one in records if one.state == "complete"))
        report(name, epochs, seconds, best)


def report(name: str, epochs: Sequence[float], seconds: Sequence[float], best: Sequence[float]) -> None:
    """Print a pruner's line: part of the epochs, processor time [s] and best error [K] of each study."""
    print(
        f"  {name:10s} epochs {statistics.fmean(epochs):.2f} ({min(epochs):.2f} to {max(epochs):.2f})"
        f"  CPU {statistics.fmean(seconds):.1f} s  best {statistics.fmean(best):.4f} +- "
        f"{statistics.stdev(best):.4f}  {' '.join(f'{one:.4f}' for one in best)}",
        flush=True,
    )


def main() -> None:
    """Replay, or run whole studies."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--live", type=int, nargs="*", default=[], metavar="N_TRAIN")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--pruners", nargs="+", default=["catch-up", "median"])
    chosen = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    with tempfile.TemporaryDirectory() as folder:
        trials = read(chosen.file)
        for n_train in chosen.live:
            spec = office_spec(Path(folder), n_train)
            live(
                spec,
                [one for one in trials if one.n_train == n_train],
                chosen.seeds,
                chosen.trials,
                chosen.pruners,
            )
        if chosen.live:
            return
        for n_train in sorted({one.n_train for one in trials}):
            spec = office_spec(Path(folder), n_train)
            replay([one for one in trials if one.n_train == n_train], spec)


if __name__ == "__main__":
    main()
