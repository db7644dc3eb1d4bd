"""The best mean of a size: which surrogates it is made of, what they count, and what it errs by."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pelsvae.mean_shares import mean_shares
from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.surrogate import Surrogate
from pelsvae.surrogate_files import save_surrogate
from studies.paths import ProjectPaths
from studies.results.best_mean import BestMean, MeanPart, in_words
from studies.results.declaration import Declaration
from studies.results.provenance import file_digest
from studies.results.trials import TrialView, TunedStudy
from studies.search_space import is_own
from studies.tracking.runs import SURROGATE, RunStore, load_surrogate
from studies.tracking.study_run import log_mean
from studies.tuning.trial_training import StudyData, errors_by_name, load_data

N_TRIALS = 4
"""Trials that a mean may be made of, beside PCA + GP."""


def best_mean(
    runs: RunStore,
    paths: ProjectPaths,
    found: TunedStudy,
    baseline: TrialView | None,
    record: Mapping[str, Any],
    *,
    parent: str,
) -> BestMean | None:
    """Return the best mean of the best trials of a size and PCA + GP; it is made where they are new.

    Args:
        runs: the project's runs.
        paths: the project.
        found: all studies whose errors compare.
        baseline: the trial of PCA + GP.
        record: what makes the data sets again.
        parent: MLflow's run of the study.

    Returns:
        The mean; None without a trial, with cross-validation, where no row weighs it, and for "paper".
    """
    best, spec = found.best_trial, found.spec
    # What was published is one network, and a user's class stands for itself.
    if best is None or spec.folds or spec.surrogate == "paper" or is_own(best.spec.surrogate):
        return None
    wanted = [best, *(one for one in found.usable if one != best)]
    # Weights are kept of trials that were among the best when they ended.
    with_weights = (one for one in wanted if runs.is_there(one.run_id) and runs.has(one.run_id, SURROGATE))
    candidates = [one for one, _ in zip(with_weights, range(N_TRIALS), strict=False)]
    if baseline is not None and runs.is_there(baseline.run_id) and runs.has(baseline.run_id, SURROGATE):
        candidates.append(baseline)
    run_ids = tuple(one.run_id for one in candidates)
    if found.mean is not None and found.mean.candidates == run_ids:
        return found.mean
    surrogates = [one for run_id in run_ids if isinstance(one := load_surrogate(runs, run_id), Surrogate)]
    data = load_data(spec, paths)
    mean, used = mean_of(spec, surrogates, data)
    errors = judge(mean, spec, data)
    parts = tuple(
        MeanPart(
            kind=_kind(candidates[k].spec),
            study=candidates[k].spec.name,
            trial=candidates[k].number,
            run_id=run_ids[k],
            share=share,
            decoder=surrogates[k].config.decoder,
            metrics=dict(candidates[k].metrics),
        )
        for k, share in zip(used, mean.shares, strict=True)
    )
    made = BestMean(run_ids, parts, metrics=errors)
    if found.mean is not None and made.parts == found.mean.parts:
        return replace(found.mean, candidates=run_ids)
    if not made.is_worth_it(best.metrics["val/mae"]):
        return BestMean(run_ids)
    with tempfile.TemporaryDirectory(prefix="studies-weights-") as scratch:
        folder = Path(scratch) / SURROGATE
        save_surrogate(mean, folder)
        of_parts = [one.run_id for one in parts]
        about = {**record, "kind": "mean", "declaration": spec.to_dict(), "parts": of_parts}
        params = dict(best.params) if best.run_id in of_parts else {}
        shares = {share_name(k): one.share for k, one in enumerate(parts)}
        run_id = log_mean(
            runs,
            spec,
            parent=parent,
            # Processes have next to no curve.
            leading=max(parts, key=lambda one: (one.kind != "pca-gp", one.share)).run_id,
            params={"model": in_words(parts), **params},
            metrics={**errors, **shares},
            record=about,
            weights=folder,
        )
        return replace(made, run_id=run_id, weights_sha256=file_digest(folder / "weights.npz"))


def _kind(spec: Declaration) -> Literal["trial", "confirmation", "pca-gp"]:
    return "pca-gp" if spec.is_baseline else "confirmation" if spec.is_confirmation else "trial"


def share_name(place: int) -> str:
    """Return the name of the metric that is a part's share."""
    return f"share/{place + 1}"


def mean_of(
    spec: Declaration, surrogates: list[Surrogate], data: StudyData
) -> tuple[MeanSurrogate, list[int]]:
    """Return the mean of least absolute error over the validation rows, and which surrogates count in it."""
    theta, y = data["validation"]
    used = list(range(len(surrogates)))
    while True:
        parts = [surrogates[k] for k in used]
        share = mean_shares(parts, theta, y, np.array(spec.output_scales))
        # Once more with those alone that count: so its parts alone make it again to the last digit.
        if (share > 0.0).all():
            return MeanSurrogate(tuple(parts), tuple(share.tolist())), used
        used = [k for k, one in zip(used, share, strict=True) if one > 0.0]


def judge(mean: MeanSurrogate, spec: Declaration, data: StudyData) -> dict[str, float]:
    """Return the errors of a mean by name, as those of a trial. [first output's unit]."""
    errors: dict[str, float] = {}
    for name, (theta, y) in {"val": data["validation"], "test": data["test"]}.items():
        errors |= errors_by_name(name, mean.predict(theta), y, spec)
    return errors
