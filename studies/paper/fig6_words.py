"""Fig. 6 in sentences, each with its numbers."""

from collections.abc import Mapping
from typing import Any

from studies.paper.published import FIG_6_LATENT, FIG_6_MAE, FIG_6_RANGE
from studies.paper.result import Agreement
from studies.report.wording import count, listed, percent, quantity, significant

Numbers = Mapping[int, Mapping[str, Any]]


def verdict(
    found: Numbers, importances: Mapping[str, Mapping[str, float]], unit: str
) -> tuple[Agreement, str]:
    """Say how Fig. 6 compares with the paper: it agrees where no error is above the paper's.

    Args:
        found: what each size came to, by name.
        importances: of the hyperparameters, by size and for "all" sizes.
        unit: unit of the errors.
    """
    agreement, against = _against_the_paper(found, unit)
    parts = [
        _course(found, unit),
        against,
        _mean(found, unit),
        _range(found, unit),
        _chosen(found),
        _gain(found),
        _importance(importances),
        _pca_gp(found, unit),
        _faithful(found, unit),
        "The paper does not print layers, activation, batch size, optimizer, patience, L or beta, so its "
        "networks cannot be rebuilt exactly.",
    ]
    return agreement, " ".join(part for part in parts if part)


def _course(found: Numbers, unit: str) -> str:
    first, last = min(found), max(found)
    falls = found[last]["best_mae"] < found[first]["best_mae"]
    return (
        f"The error {'falls with the training set as in the paper' if falls else 'does not fall'}: "
        f"{quantity(found[first]['best_mae'], unit, 2)} at n = {first}, "
        f"{quantity(found[last]['best_mae'], unit, 2)} at n = {count(last)}."
    )


def _against_the_paper(found: Numbers, unit: str) -> tuple[Agreement, str]:
    size, low, _ = FIG_6_RANGE
    theirs = {n: mae for n, mae in sorted({**FIG_6_MAE, size: low}.items()) if n in found}
    if not theirs:
        return "beyond the paper", "The paper names no error at these sizes."
    no_worse = [n for n, mae in theirs.items() if found[n]["best_mae"] <= mae]
    said = [
        f"{quantity(found[n]['best_mae'], unit, 2)} against {quantity(mae, unit, 2)} at n = {count(n)}"
        for n, mae in theirs.items()
    ]
    agreement: Agreement = (
        "agrees" if len(no_worse) == len(theirs) else "agrees in part" if no_worse else "differs"
    )
    return agreement, (
        f"It is at or below the paper's error at {len(no_worse)} of the {count(len(theirs), 'size')} that "
        f"the paper names: {listed(said)}."
    )


def _mean(found: Numbers, unit: str) -> str:
    if 32 not in found:
        return ""
    mean, ours = found[32]["mean_predictor_mae"], found[32]["best_mae"]
    return (
        f"At n = 32 predicting the mean trajectory errs by {quantity(mean, unit, 2)}, ours by "
        f"{percent(ours / mean)} of that."
    )


def _range(found: Numbers, unit: str) -> str:
    size, low, high = FIG_6_RANGE
    if size not in found:
        return ""
    ours = found[size]
    return (
        f"At n = {size} the complete trials err by {quantity(ours['best_mae'], unit, 2)} to "
        f"{quantity(ours['worst_mae'], unit, 2)} (paper: {low} to {high} {unit}). "
        f"{count(ours['n_pruned'], 'trial')} of {ours['trials']} were pruned and would widen this range."
    )


def _chosen(found: Numbers) -> str:
    latent = {n: numbers["n_latent"] for n, numbers in found.items()}
    inside = [n for n, z in latent.items() if FIG_6_LATENT[0] <= z <= FIG_6_LATENT[1]]
    hidden = [count(numbers["n_hidden"]) for numbers in found.values()]
    return (
        f"The best latent dimensions are {listed(count(z) for z in latent.values())}, from the smallest to "
        f"the largest size (paper: {FIG_6_LATENT[0]} to {FIG_6_LATENT[1]}, which holds {len(inside)} of "
        f"{len(latent)}). The best hidden widths are {listed(hidden)}."
    )


def _gain(found: Numbers) -> str:
    gains = {n: numbers["gain"] for n, numbers in found.items() if numbers["gain"] is not None}
    if not gains:
        return ""
    said = [f"{'+' if gain < 0.0 else ''}{percent(-gain)} at n = {count(n)}" for n, gain in gains.items()]
    return (
        f"Tuning changes the test error of the default configuration by {listed(said)}; with one seed per "
        "trial, a few percent are noise."
    )


def _importance(importances: Mapping[str, Mapping[str, float]]) -> str:
    parts = importances["all"]
    if not parts:
        return ""
    said = [f"{name} {percent(part)}" for name, part in parts.items()]
    return f"By Optuna's PED-ANOVA over the trials of all sizes, the importances are {listed(said)}."


def _pca_gp(found: Numbers, unit: str) -> str:
    ratios = {n: numbers["ratio_to_pca_gp"] for n, numbers in found.items() if "ratio_to_pca_gp" in numbers}
    if not ratios:
        return ""
    lost = [n for n, ratio in ratios.items() if ratio > 1.0]
    said = [
        f"{significant(ratio)} at n = {count(n)} ({quantity(found[n]['pca_gp_mae'], unit, 2)})"
        for n, ratio in ratios.items()
    ]
    return (
        f"PCA + GP errs less at {len(lost)} of {count(len(ratios), 'size')}; the networks' error is a "
        f"multiple of its error: {listed(said)}."
    )


def _faithful(found: Numbers, unit: str) -> str:
    known = {n: numbers for n, numbers in found.items() if "faithful_mae" in numbers}
    if not known:
        return ""
    said = [f"{quantity(numbers['faithful_mae'], unit, 2)} at n = {count(n)}" for n, numbers in known.items()]
    trials = [numbers["faithful_trials"] for numbers in known.values()]
    each = count(max(trials), "trial") if len(set(trials)) == 1 else f"{min(trials)} to {max(trials)} trials"
    return f"The faithful form, with {each} per size, reaches {listed(said)}."
