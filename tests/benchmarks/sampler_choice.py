"""Which of Optuna's samplers finds the best surrogate of the office, for one error and for two.

Run `python tests/benchmarks/sampler_choice.py FILE [--sizes 64] [--train 20]`; FILE is the one of
trained_trials.py. Two tables:

--train N really trains N trials per seed with each sampler (kept beside FILE) and prints the best validation
MAE; the Gaussian process's studies are those in FILE.

Without it nothing is trained: a proposal becomes the nearest of the kept trials that the study has not had
yet. That landscape is coarse, and densest where the Gaussian process went, so it flatters nobody much but
is no more than a hint; it serves for two errors, where the dominated area of MAE and 90th percentile is told
as a part of the area that all kept trials dominate. (NSGA-II keeps its generations in the study, and ours is
made anew for every trial: it would be random search.)
"""

import argparse
import json
import statistics
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import optuna
from optuna.samplers import BaseSampler, GPSampler, RandomSampler, TPESampler
from optuna.trial import create_trial
from trained_trials import Trained, office_spec, read, train

from studies.tuning.coordinates import Params, distributions
from studies.tuning.search_space import N_STARTUP_TRIALS, derived_seed, proposal_of
from studies.tuning.study_data import load_data
from studies.tuning.study_spec import StudySpec

LENGTHS = (10, 20, 40)
MAE, BOTH = ("val/mae",), ("val/mae", "val/p90")
SAMPLERS: dict[str, Callable[[int], BaseSampler]] = {
    "GP": lambda seed: GPSampler(seed=seed, n_startup_trials=N_STARTUP_TRIALS),
    "TPE": lambda seed: TPESampler(seed=seed, multivariate=True, n_startup_trials=N_STARTUP_TRIALS),
    "random": lambda seed: RandomSampler(seed=seed),
}


def suggested(
    spec: StudySpec, past: Sequence[Trained], sampler: BaseSampler, objectives: Sequence[str]
) -> Params:
    """Ask a sampler for the next trial."""
    space = distributions(spec.search)
    study = optuna.create_study(directions=["minimize"] * len(objectives), sampler=sampler)
    worst = {name: max(one.metrics[name] for one in past if one.metrics) for name in objectives}
    for one in past:
        values = [one.metrics.get(name, worst[name]) for name in objectives]
        study.add_trial(create_trial(params=dict(one.params), distributions=space, values=values))
    return dict(study.ask(space).params)


def place(params: Params) -> np.ndarray:
    """Return a configuration in units that make the searched ranges about equally wide."""
    beta, rate = np.log10(params["beta"]) / 3.0, np.log10(params["learning_rate"])
    return np.array([beta, rate, params["log2_n_latent"] / 4.0, params["log2_n_hidden"] / 2.0])


def looked_up(
    spec: StudySpec, kept: Sequence[Trained], make: Callable[[int], BaseSampler], objectives: Sequence[str]
) -> list[Trained]:
    """Return a study whose proposals become the nearest kept trials."""
    places = np.array([place(one.params) for one in kept])
    past, left = [kept[0]], np.ones(len(kept), dtype=bool)
    left[0] = False
    for index in range(1, max(LENGTHS)):
        wanted = suggested(spec, past, make(derived_seed(spec.seed, index, 0)), objectives)
        distance = np.where(left, np.linalg.norm(places - place(wanted), axis=1), np.inf)
        nearest = int(distance.argmin())
        left[nearest] = False
        past.append(kept[nearest])
    return past


def dominated(trials: Sequence[Trained], corner: Sequence[float]) -> float:
    """Return the area between a corner and the front of MAE and 90th percentile. [K²]."""
    points = sorted(tuple(one.metrics[name] for name in BOTH) for one in trials)
    area, height = 0.0, corner[1]
    for mae, p90 in points:
        if mae < corner[0] and p90 < height:
            area += (corner[0] - mae) * (height - p90)
            height = p90
    return area


def trained_study(
    spec: StudySpec, known: Sequence[Trained], default: Trained, name: str, n_trials: int, file: Path
) -> list[Trained]:
    """Return a study with a sampler, training what is missing."""
    data, past = load_data(spec), [default]
    for index in range(1, n_trials):
        found = [one for one in known if (one.seed, one.index) == (spec.seed, index)]
        if not found:
            sampler = SAMPLERS[name](derived_seed(spec.seed, index, 0))
            proposal = proposal_of(spec, index, suggested(spec, past, sampler, MAE), origin=name)
            found = [train(spec, proposal, data, index)[0]]
            with file.open("a") as stream:
                stream.write(json.dumps(asdict(found[0])) + "\n")
        past += found
    return past


def tell(name: str, n: int, values: Sequence[float]) -> None:
    """Print a sampler's line."""
    spread = f"({min(values):.4f} to {max(values):.4f}, {len(values)} seeds)"
    print(f"  {name:8s} {n:2d} trials: {statistics.median(values):.4f} {spread}", flush=True)


def main() -> None:
    """Compare."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--train", type=int, metavar="N")
    chosen = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    with tempfile.TemporaryDirectory() as folder:
        for n_train in chosen.sizes:
            spec = office_spec(Path(folder), n_train)
            kept = [one for one in read(chosen.file) if one.n_train == n_train and one.metrics]
            if chosen.train:
                print(f"n_train {n_train}, trained: best validation MAE [K]")
                for name in ("GP", "TPE", "random"):
                    file = chosen.file.with_name(f"{chosen.file.stem}-{name}.jsonl")
                    known = read(file) if name != "GP" else kept
                    found = [
                        trained_study(replace(spec, seed=seed), known, kept[0], name, chosen.train, file)
                        for seed in range(chosen.seeds)
                    ]
                    for n in [n for n in LENGTHS if n <= chosen.train]:
                        tell(name, n, [min(one.metrics["val/mae"] for one in one[:n]) for one in found])
                continue
            corner = [statistics.median(one.metrics[name] for one in kept) for name in BOTH]
            whole = dominated(kept, corner)
            for objectives in (MAE, BOTH):
                print(f"n_train {n_train}, looked up among {len(kept)}: {' and '.join(objectives)}")
                for name, make in SAMPLERS.items():
                    studies = [
                        looked_up(replace(spec, seed=seed), kept, make, objectives)
                        for seed in range(chosen.seeds)
                    ]
                    for n in LENGTHS:
                        best = [min(one.metrics["val/mae"] for one in study[:n]) for study in studies]
                        tell(name, n, best)
                        if objectives == BOTH:
                            tell("  area", n, [dominated(study[:n], corner) / whole for study in studies])


if __name__ == "__main__":
    main()
