"""Fig. 6: every trial's error over the training-set size, and how much hyperparameters matter at each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.store.row_set import RowSet
from studies.paper.plan import SIMULATIONS_PER_S, Plan
from studies.paper.published import FIG_6_LATENT, FIG_6_MAE, FIG_6_RANGE
from studies.paper.result import ERROR, Agreement, ItemResult, columns_in
from studies.paper.tuned import Tuned, tune_sizes
from studies.report import captions
from studies.report.contents import Picture
from studies.report.figures_by_size import LatentTrials, latent_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.tables import Table
from studies.report.wording import count, difference_unit, listed, quantity, significant
from studies.stages.simulate import set_files, train_seed
from studies.stages.tuned_trials import trials_record, tuned_by_size
from studies.tuning.results import TrialView, TunedStudy

CLOSE = 1.5
"""Errors within this factor of each other are called the same: it is read from a figure, and noise is 5 %."""

COLUMNS = (
    ("n_train", "training simulations", ""),
    ("trials", "trials", ""),
    ("best_mae", "best MAE", ERROR),
    ("best_p90", "its 90th percentile", ERROR),
    ("default_mae", "MAE untuned", ERROR),
    ("median_mae", "median MAE", ERROR),
    ("worst_mae", "worst MAE", ERROR),
    ("mean_predictor_mae", "MAE of predicting the mean", ERROR),
    ("n_latent", "latent dimension", ""),
    ("n_hidden", "hidden width", ""),
    ("beta", "beta", ""),
    ("paper_mae", "paper's best MAE", "K"),
)


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    budget = plan.budget
    profile = plan.study.profile.to_dict()
    tuning = {key: value for key, value in profile["tuning"].items() if key != "n_trials"}
    return {"n_train": list(budget.n_train), "trials": budget.trials, "tuning": tuning}


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    n_rows = max(plan.budget.n_train) + 640
    return plan.training_s(plan.budget.n_train, plan.budget.trials) + n_rows / SIMULATIONS_PER_S


def run(plan: Plan) -> ItemResult:
    """Tune every size on the window of Fig. 6 and compare all its trials."""
    trials = plan.budget.trials
    tuned = tune_sizes(plan.hyperparameter_study(plan.budget.n_train, min(trials.values())), trials)
    study = tuned.study
    by_size = tuned_by_size(study)
    groups = {n: one.trials for n, one in by_size.items()}
    drawn = trials_record(by_size)
    assert drawn is not None, "a tuning stage ends with trials"
    unit = difference_unit(study.case.outputs[0].unit)
    found = {n: _numbers(one) for n, one in sorted(by_size.items())}
    for n, error in _mean_predictor(tuned).items():
        found[n]["mean_predictor_mae"] = error
    latent = _by_latent(groups)
    agreement, verdict = _verdict(found, latent, unit)
    window = f"days {study.case.window_d[0]:g} to {study.case.window_d[1]:g}"
    return ItemResult(
        agreement=agreement,
        verdict=verdict,
        numbers={
            "by_size": found,
            "mean_ratio_to_best_by_latent": latent,
            "window_d": list(study.case.window_d),
        },
        paper={"best_mae": FIG_6_MAE, "range": list(FIG_6_RANGE), "best_latent": list(FIG_6_LATENT)},
        tables=(
            Table(
                "sizes",
                f"Hyperparameter studies on {window}; worst and median are over complete trials",
                columns_in(unit, COLUMNS),
                tuple(_row(n, numbers) for n, numbers in found.items()),
            ),
        ),
        pictures=(
            Picture(
                "mae-over-n",
                "Every trial's error over the training-set size",
                captions.trials_caption(drawn, unit),
                lambda path: mae_over_n_figure(drawn, path, unit=unit, footnote=f"{study.label}, {window}"),
            ),
            Picture(
                "latent",
                "Error over the latent dimension",
                _latent_caption(latent),
                lambda path: latent_figure(
                    {n: _latent_trials(one) for n, one in sorted(by_size.items())},
                    path,
                    title="Latent dimension and test error of every complete trial",
                    unit=unit,
                    footnote=f"{study.label}, {window}",
                ),
            ),
        ),
        n_calls=tuned.n_simulations,
        work_s=tuned.wall_s,
        seeds={"training design": train_seed(study.profile.seed), "trials": study.profile.seed},
        settings=(
            ("window", window),
            ("trials per size", ", ".join(f"{n}: {len(records)}" for n, records in sorted(groups.items()))),
        ),
        metrics={f"best_mae/n{n:04d}": numbers["best_mae"] for n, numbers in found.items()},
        uses=tuned.commands(trials),
    )


def _complete(records: Sequence[TrialView]) -> list[TrialView]:
    return [record for record in records if record.state == "complete" and record.run_id]


def _mae(records: Sequence[TrialView]) -> FloatArray:
    return np.array([record.metrics["test/mae"] for record in records], dtype=np.float64)


def _of(records: Sequence[TrialView], setting: str) -> FloatArray:
    return np.array([record.settings[setting] for record in records], dtype=np.float64)


def _latent_trials(study: TunedStudy) -> LatentTrials:
    complete, best = _complete(study.trials), study.best
    assert best is not None, "the stage refuses a size without a complete trial"
    return LatentTrials(_of(complete, "n_latent"), _mae(complete), complete.index(best))


def _numbers(study: TunedStudy) -> dict[str, Any]:
    records, complete, best = study.trials, _complete(study.trials), study.best
    assert best is not None, "the stage refuses a size without a complete trial"
    errors = _mae(complete)
    first = study.default
    return {
        "trials": len(records),
        "n_complete": len(complete),
        "n_pruned": sum(r.state == "pruned" for r in records),
        "n_failed": sum(r.state == "failed" for r in records),
        "best_mae": best.metrics["test/mae"],
        "best_p90": best.metrics["test/p90"],
        "default_mae": None if first is None else first.metrics["test/mae"],
        "median_mae": float(np.median(errors)),
        "worst_mae": float(errors.max()),
        "n_latent": best.settings["n_latent"],
        "n_hidden": best.settings["n_hidden"],
        "beta": best.settings["beta"],
    }


def _row(n: int, numbers: dict[str, Any]) -> tuple[Any, ...]:
    named = {"n_train": n, "paper_mae": FIG_6_MAE.get(n), **numbers}
    return tuple(named[key] for key, _, _ in COLUMNS)


def _mean_predictor(tuned: Tuned) -> dict[int, float]:
    """Return the test error of predicting the training set's mean trajectory, by size. [output's unit]."""
    files = set_files(tuned.study, tuned.simulated.summary)
    scales = tuned.study.case.measurement.error_scales
    train, test = RowSet.load(files["train"]).read().y, RowSet.load(files["test"]).read().y
    test = test[np.isfinite(test).all(axis=(1, 2))]
    return {
        n: float(np.mean(np.abs(np.nanmean(train[:n], axis=0) - test) * scales))
        for n in tuned.study.profile.data.n_train
    }


def _by_latent(groups: Mapping[int, Sequence[TrialView]]) -> dict[int, float]:
    """Return by latent dimension the geometric mean of (MAE / best MAE of the same size). [1]."""
    ratios: dict[int, list[float]] = {}
    for records in groups.values():
        complete = _complete(records)
        errors = _mae(complete)
        for record, ratio in zip(complete, (errors / errors.min()).tolist(), strict=True):
            ratios.setdefault(int(record.settings["n_latent"]), []).append(ratio)
    return {z: float(np.exp(np.mean(np.log(found)))) for z, found in sorted(ratios.items())}


def _latent_caption(latent: dict[int, float]) -> str:
    said = [f"{z}: {significant(ratio, 3)}" for z, ratio in latent.items()]
    return (
        "Error as a multiple of the best of the same size, geometric mean over complete trials, by latent "
        f"dimension: {', '.join(said)}. Pruned trials are missing, which flatters bad dimensions."
    )


def _verdict(found: dict[int, dict[str, Any]], latent: dict[int, float], unit: str) -> tuple[Agreement, str]:
    known = {n: (found[n]["best_mae"], mae) for n, mae in FIG_6_MAE.items() if n in found}
    close = [max(ours / theirs, theirs / ours) <= CLOSE for ours, theirs in known.values()]
    agreement: Agreement = "differs"
    if known:
        agreement = "agrees" if all(close) else "agrees in part" if any(close) else "differs"
    first, last = min(found), max(found)
    falls = found[last]["best_mae"] < found[first]["best_mae"]
    parts = [
        f"The error {'falls with the training set as in the paper' if falls else 'does not fall'}: "
        f"{quantity(found[first]['best_mae'], unit, 2)} at n = {first}, "
        f"{quantity(found[last]['best_mae'], unit, 2)} at n = {count(last)}."
    ]
    if known:
        said = [
            f"{quantity(ours, unit, 2)} against about {quantity(theirs, unit, 2)} at n = {count(n)}"
            for n, (ours, theirs) in known.items()
        ]
        parts.append(f"Ours against the paper's figure: {listed(said)}.")
    if 32 in known:
        mean = found[32]["mean_predictor_mae"]
        better = [
            who for who, mae in (("ours", known[32][0]), ("the paper's", known[32][1])) if mae < 0.9 * mean
        ]
        parts.append(
            f"At n = 32 predicting the mean trajectory errs by {quantity(mean, unit, 2)}: "
            f"{' and '.join(better) or 'neither network'} is clearly better than that."
        )
    size, low, high = FIG_6_RANGE
    if size in found:
        ours = found[size]
        span = (
            f"the one complete trial errs by {quantity(ours['best_mae'], unit, 2)}"
            if ours["n_complete"] == 1
            else f"{count(ours['n_complete'])} complete trials span {quantity(ours['best_mae'], unit, 2)} to "
            f"{quantity(ours['worst_mae'], unit, 2)}"
        )
        parts.append(
            f"At n = {size} {span} (paper: {low} to {high} {unit}; "
            f"{count(ours['n_pruned'], 'trial')} of ours were pruned and would widen it)."
        )
    chosen = {n: numbers["n_latent"] for n, numbers in found.items()}
    inside = [n for n, z in chosen.items() if FIG_6_LATENT[0] <= z <= FIG_6_LATENT[1]]
    parts.append(
        f"Best latent dimensions are {listed(str(z) for z in chosen.values())} (paper: 64 to 256); "
        f"{len(inside)} of {len(chosen)} lie in the paper's range, and from the best to the worst dimension "
        f"the error grows by a factor of {significant(max(latent.values()) / min(latent.values()), 3)} on "
        "average."
    )
    parts.append(
        "The paper does not print layers, activation, batch size, optimizer, patience, L or beta, so its "
        "networks cannot be rebuilt exactly; ours take the first author's later public configuration."
    )
    return agreement, " ".join(parts)
