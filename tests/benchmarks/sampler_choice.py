"""Which of Optuna's samplers finds the best surrogate of the office in 10, 20 and 40 trials.

Run `python tests/benchmarks/sampler_choice.py FILE [--sizes 64]`; FILE is the one of trained_trials.py, and
the other samplers' trials are added to it. Every trial is really trained, to its end. All samplers begin
with the default and are told the same.
"""

import argparse
import json
import statistics
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import optuna
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import create_trial
from trained_trials import Trained, office_spec, read, train

from studies.tuning.coordinates import Params, distributions
from studies.tuning.search_space import N_STARTUP_TRIALS, derived_seed, proposal_of
from studies.tuning.study_data import load_data
from studies.tuning.study_spec import StudySpec

LENGTHS = (10, 20, 40)
SAMPLERS: dict[str, Callable[[int], BaseSampler]] = {
    "TPE": lambda seed: TPESampler(seed=seed, multivariate=True, n_startup_trials=N_STARTUP_TRIALS),
    "random": lambda seed: RandomSampler(seed=seed),
}


def suggested(spec: StudySpec, past: Sequence[Trained], sampler: BaseSampler) -> Params:
    """Ask a sampler for the next trial."""
    space = distributions(spec.search)
    study = optuna.create_study(sampler=sampler)
    worst = max(one.metrics["val/mae"] for one in past if one.metrics)
    for one in past:
        value = one.metrics.get("val/mae", worst)
        study.add_trial(create_trial(params=dict(one.params), distributions=space, value=value))
    return dict(study.ask(space).params)


def extended(
    spec: StudySpec,
    known: Sequence[Trained],
    default: Trained,
    name: str,
    n_trials: int,
    keep: Callable[[Trained], None],
) -> list[Trained]:
    """Return a study with a sampler, training what is missing."""
    data, past = load_data(spec), [default]
    for index in range(1, n_trials):
        found = [one for one in known if one.index == index]
        if not found:
            sampler = SAMPLERS[name](derived_seed(spec.seed, index, 0))
            proposal = proposal_of(spec, index, suggested(spec, past, sampler), origin=name)
            found = [train(spec, proposal, data, index)[0]]
            keep(found[0])
        past += found
    return past


def main() -> None:
    """Train what is missing and compare."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    chosen = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    with tempfile.TemporaryDirectory() as folder:
        for n_train in chosen.sizes:
            gp = [one for one in read(chosen.file) if one.n_train == n_train and one.seed in chosen.seeds]
            n_trials = min(len(gp) // len(chosen.seeds), max(LENGTHS))
            studies = {"GP": [[one for one in gp if one.seed == seed] for seed in chosen.seeds]}
            for name in SAMPLERS:
                file = chosen.file.with_name(f"{chosen.file.stem}-{name}.jsonl")

                def keep(one: Trained, file: Path = file) -> None:
                    with file.open("a") as stream:
                        stream.write(json.dumps(asdict(one)) + "\n")

                studies[name] = []
                for seed, (default, *_) in zip(chosen.seeds, studies["GP"], strict=True):
                    spec = replace(office_spec(Path(folder), n_train), seed=seed)
                    known = [one for one in read(file) if (one.n_train, one.seed) == (n_train, seed)]
                    studies[name].append(extended(spec, known, default, name, n_trials, keep))
            print(f"n_train {n_train}: best validation MAE [K], median (least, most)")
            for name, found in studies.items():
                line = f"  {name:8s}"
                for n in [n for n in LENGTHS if n <= n_trials]:
                    best = [
                        min(one.metrics["val/mae"] for one in study[:n] if one.metrics) for study in found
                    ]
                    line += f"  {n} trials: {statistics.median(best):.4f} ({min(best):.4f}, {max(best):.4f})"
                print(line)


if __name__ == "__main__":
    main()
