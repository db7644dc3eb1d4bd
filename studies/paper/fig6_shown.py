"""Fig. 6 as numbers, tables, pictures and sentences, from trials alone: nothing is trained here."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.paper.fig6_sizes import SizeTrials, Trial, Tuning, known
from studies.paper.fig6_words import verdict
from studies.paper.published import FIG_6_LATENT, FIG_6_MAE, FIG_6_RANGE
from studies.paper.result import ERROR, ItemResult, columns_in
from studies.paper.size_files import Origin
from studies.report import captions
from studies.report.figures_by_size import SettingTrials, setting_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.page import Picture
from studies.report.records_tuning import ErrorLine, TrialsRecord
from studies.report.tables import Table
from studies.report.wording import count, listed, significant
from studies.search_space import SearchParameter
from studies.stages.simulate import train_seed
from studies.tuning.results import importances

COLUMNS = (
    ("n_train", "training simulations", ""),
    ("trials", "trials", ""),
    ("n_pruned", "of these pruned", ""),
    ("best_mae", "best MAE", ERROR),
    ("best_p90", "its 90th percentile", ERROR),
    ("n_latent", "latent dimension", ""),
    ("n_hidden", "hidden width", ""),
    ("beta", "beta", ""),
    ("learning_rate", "learning rate", ""),
    ("default_mae", "MAE untuned", ERROR),
    ("median_mae", "median MAE", ERROR),
    ("worst_mae", "worst MAE", ERROR),
    ("pca_gp_mae", "MAE of PCA + GP", ERROR),
    ("pca_gp_p90", "its 90th percentile", ERROR),
    ("ratio_to_pca_gp", "best MAE / PCA + GP", ""),
    ("faithful_mae", "MAE of the faithful form", ERROR),
    ("faithful_trials", "its trials", ""),
    ("mean_predictor_mae", "MAE of predicting the mean", ERROR),
    ("paper_mae", "paper's best MAE", "K"),
)
SETTINGS = {"n_latent": "latent dimension", "n_hidden": "hidden width"}
"""Settings that are drawn, and what they are called."""


def shown(origin: Origin, sizes: Sequence[SizeTrials]) -> ItemResult:
    """Return Fig. 6.

    Args:
        origin: where the sizes come from.
        sizes: all trials by size, the smallest first.
    """
    unit = origin.unit
    found = {one.n_train: numbers_of_size(one) for one in sizes}
    matter = importances_by_size(sizes)
    drawn, lines = trials_record(sizes), error_lines(sizes)
    agreement, text = verdict(found, matter, unit)
    window = f"days {origin.window_d[0]:g} to {origin.window_d[1]:g}"
    footnote = f"{origin.label}, {window}"
    low, high = FIG_6_RANGE[1:]
    published = {n: (mae,) for n, mae in FIG_6_MAE.items()} | {FIG_6_RANGE[0]: (low, high)}
    return ItemResult(
        agreement=agreement,
        verdict=text,
        numbers={"by_size": found, "importances": matter, "window_d": list(origin.window_d)},
        paper={"best_mae": FIG_6_MAE, "range": list(FIG_6_RANGE), "best_latent": list(FIG_6_LATENT)},
        tables=(
            Table(
                "sizes",
                f"Hyperparameter studies on {window}; worst and median are over complete trials",
                columns_in(unit, COLUMNS),
                tuple(tuple(numbers.get(key) for key, _, _ in COLUMNS) for numbers in found.values()),
            ),
        ),
        pictures=(
            Picture(
                "mae-over-n",
                "Every trial's error over the training-set size",
                captions.trials_caption(drawn),
                lambda path: mae_over_n_figure(
                    drawn, path, unit=unit, footnote=footnote, beside=lines, published=published
                ),
            ),
            *(
                _setting_picture(name, sizes, unit, footnote)
                for name in SETTINGS
                if _is_searched(sizes, name)
            ),
        ),
        n_calls={
            "train set": max(found),
            "validation set": origin.n_validation,
            "test set": origin.n_test,
        },
        work_s=sum(trial.wall_s for one in sizes for tuning in _tunings(one) for trial in tuning.trials),
        seeds={"training design": train_seed(origin.seed), "trials": origin.seed},
        settings=(
            ("window", window),
            ("surrogate", sizes[0].networks.surrogate),
            ("trials per size", ", ".join(f"{n}: {numbers['trials']}" for n, numbers in found.items())),
        ),
        metrics={f"best_mae/n{n:04d}": numbers["best_mae"] for n, numbers in found.items()},
    )


def numbers_of_size(size: SizeTrials) -> dict[str, Any]:
    """Return what one size came to, by name; a number that does not exist is None."""
    tuning, best = size.networks, size.networks.best
    errors = _errors(tuning.complete)
    numbers: dict[str, Any] = {
        "n_train": size.n_train,
        "trials": len(tuning.trials),
        "n_planned": tuning.n_planned,
        "n_proposed": tuning.n_proposed,
        "n_complete": len(tuning.complete),
        "n_pruned": _n(tuning, "pruned"),
        "n_failed": _n(tuning, "failed"),
        "best_trial": best.number,
        "best_mae": best.test_mae,
        "best_p90": best.test_p90,
        "best_val_mae": best.val_mae,
        **{name: tuning.setting(best, name) for name in ("n_latent", "n_hidden", "beta", "learning_rate")},
        "default_mae": None if tuning.default is None else tuning.default.test_mae,
        "gain": _gain(best, tuning.default),
        "median_mae": float(np.median(errors)),
        "worst_mae": float(errors.max()),
        "mean_predictor_mae": size.mean_predictor_mae,
        "paper_mae": FIG_6_MAE.get(size.n_train),
    }
    if size.pca_gp is not None:
        other = size.pca_gp.best
        ratio = known(best.test_mae) / known(other.test_mae)
        numbers |= {"pca_gp_mae": other.test_mae, "pca_gp_p90": other.test_p90, "ratio_to_pca_gp": ratio}
    if size.faithful is not None:
        other = size.faithful.best
        numbers |= {
            "faithful_mae": other.test_mae,
            "faithful_p90": other.test_p90,
            "faithful_trials": len(size.faithful.trials),
            "faithful_latent": size.faithful.setting(other, "n_latent"),
            "faithful_hidden": size.faithful.setting(other, "n_hidden"),
        }
    return numbers


def importances_by_size(sizes: Sequence[SizeTrials]) -> dict[str, dict[str, float]]:
    """Return the importance of each hyperparameter by size, and over all sizes together. [1].

    Pruned trials count with their last validation error. Over all sizes the error is that divided by the best
    of the size.
    """
    found: dict[str, dict[str, float]] = {}
    points: list[dict[str, Any]] = []
    ratios: list[float] = []
    space = {name: SearchParameter(**one) for name, one in sizes[0].networks.search.items()}
    for size in sizes:
        values = [known(trial.val_mae) for trial in size.networks.judged]
        here = [trial.params for trial in size.networks.judged]
        found[str(size.n_train)] = importances(here, values, space)
        points += here
        ratios += [value / known(size.networks.best.val_mae) for value in values]
    return {**found, "all": importances(points, ratios, space)}


def trials_record(sizes: Sequence[SizeTrials]) -> TrialsRecord:
    """Return all trials of the networks as the picture takes them."""
    trials = [(size, trial) for size in sizes for trial in size.networks.trials]
    return TrialsRecord(
        n_train=np.array([size.n_train for size, _ in trials], dtype=np.int64),
        state=tuple(trial.state for _, trial in trials),
        validation_mae=_floats([trial.val_mae for _, trial in trials]),
        test_mae=_floats([trial.test_mae for _, trial in trials]),
        test_p90=_floats([trial.test_p90 for _, trial in trials]),
        is_best=np.array([trial is size.networks.best for size, trial in trials]),
    )


def error_lines(sizes: Sequence[SizeTrials]) -> tuple[ErrorLine, ...]:
    """Return what is drawn as a line beside the trials: PCA + GP, and the best of the faithful form."""
    lines = []
    for name, tunings in (
        ("PCA + GP", {size.n_train: size.pca_gp for size in sizes}),
        ("faithful form, its best", {size.n_train: size.faithful for size in sizes}),
    ):
        best = {n: tuning.best for n, tuning in tunings.items() if tuning is not None}
        if best:
            mae = _floats([trial.test_mae for trial in best.values()])
            p90 = _floats([trial.test_p90 for trial in best.values()])
            lines.append(ErrorLine(name, np.array(list(best), dtype=np.int64), mae, p90))
    return tuple(lines)


def _setting_picture(name: str, sizes: Sequence[SizeTrials], unit: str, footnote: str) -> Picture:
    what = SETTINGS[name]
    ratios = ratio_by_octave(sizes, name)
    said = [f"{count(value)}: {significant(ratio, 3)}" for value, ratio in ratios.items()]
    return Picture(
        name.removeprefix("n_"),
        f"Error over the {what}",
        "Validation error as a multiple of the best of the same size, geometric mean over trials, by the "
        f"nearest power of two of the {what}: {listed(said)}. Pruned trials count with their last error.",
        lambda path: setting_figure(
            {size.n_train: _setting_trials(size.networks, name) for size in sizes},
            path,
            what=what,
            title=f"{what[:1].upper()}{what[1:]} and error of every trial",
            unit=unit,
            footnote=footnote,
        ),
    )


def ratio_by_octave(sizes: Sequence[SizeTrials], name: str) -> dict[int, float]:
    """Return by power of two the geometric mean of (validation MAE / best of the same size). [1]."""
    ratios: dict[int, list[float]] = {}
    for size in sizes:
        tuning, least = size.networks, known(size.networks.best.val_mae)
        for trial in tuning.judged:
            octave = 2 ** round(math.log2(tuning.setting(trial, name)))
            ratios.setdefault(octave, []).append(known(trial.val_mae) / least)
    return {value: float(np.exp(np.mean(np.log(found)))) for value, found in sorted(ratios.items())}


def _is_searched(sizes: Sequence[SizeTrials], name: str) -> bool:
    return any(name in size.networks.search for size in sizes)


def _setting_trials(tuning: Tuning, name: str) -> SettingTrials:
    pruned = [trial for trial in tuning.judged if trial.state == "pruned"]
    return SettingTrials(
        values=_floats([tuning.setting(trial, name) for trial in tuning.complete]),
        test_mae=_errors(tuning.complete),
        best=tuning.complete.index(tuning.best),
        pruned_values=_floats([tuning.setting(trial, name) for trial in pruned]),
        pruned_mae=_floats([trial.val_mae for trial in pruned]),
    )


def _tunings(size: SizeTrials) -> list[Tuning]:
    return [one for one in (size.networks, size.faithful, size.pca_gp) if one is not None]


def _gain(best: Trial, default: Trial | None) -> float | None:
    if default is None:
        return None
    return 1.0 - known(best.test_mae) / known(default.test_mae)


def _n(tuning: Tuning, state: str) -> int:
    return sum(trial.state == state for trial in tuning.trials)


def _errors(trials: Sequence[Trial]) -> FloatArray:
    return _floats([trial.test_mae for trial in trials])


def _floats(values: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
