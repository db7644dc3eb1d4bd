"""How sure a calibration is, as figures, tables and sentences want it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.calibration.misfit_threshold import misfit_threshold
from studies.report.records import Floats
from studies.report.wording import (
    count,
    difference_unit,
    digits_between,
    listed,
    significant,
    squared,
)

UNCORRELATED = 0.9
"""Samples that are worth this share of their number are said to be uncorrelated."""
FITS_BETTER = 0.99
"""Share of a calibration's error below which another parameter set is said to fit better."""

HOW_KNOWN = {
    "determined": "determined",
    "narrowed": "narrowed",
    "open": "not determined",
    "prior": "as known before",
    "unsure": "too few calls",
}


@dataclass(frozen=True)
class UncertaintyRecord:
    """The uncertainty of one calibration.

    Attributes:
        calibration: Name of the calibration: "adaptive" or "n0064".
        level: Probability of intervals and bands. [1]
        noise: The noise model in words, but for the unit: see `noise_sentence`.
        names: One name per parameter.
        calibrated: Shape (p,). [per parameter]
        linear: Linearised intervals. Shape (2, p). [per parameter]
        interval: Intervals of the posterior, NaN where it is not trusted. Shape (2, p). [per parameter]
        known: A key of `HOW_KNOWN`, one per parameter.
        pairs: Which two compensate each other, in words, the clearest first; none where it is not trusted.
        null_directions: Combinations that hardly change any output near the point, in words.
        particles: A sample of the posterior by the surrogate. Shape (c, p). [per parameter]
        weights: What each counts; sum 1. Shape (n,). [1]
        simulated: Band of the simulated outputs. Shape (2, t, k). [per output]
        predictive: The same with noise. Shape (2, t, k). [per output]
        n_effective: Parameter sets of equal weight that the sample is worth.
        is_trusted: Whether that is enough.
        mse: Error of the calibration. [first output's unit squared]
        best_mse: Lowest error of all rows that are known. [first output's unit squared]
        has_prior: Whether anything was known beforehand.
        sensor: Uncertainty of the first output's sensor, infinite where it is not known. [its unit]
        ledger: Calls by what they were for.
    """

    calibration: str
    level: float
    noise: Mapping[str, Any]
    names: tuple[str, ...]
    calibrated: Floats
    linear: Floats
    interval: Floats
    known: tuple[str, ...]
    pairs: tuple[str, ...]
    null_directions: tuple[str, ...]
    particles: Floats
    weights: Floats
    simulated: Floats
    predictive: Floats
    n_effective: float
    is_trusted: bool
    mse: float
    best_mse: float
    has_prior: bool
    sensor: float
    ledger: Mapping[str, int]

    @property
    def digits(self) -> tuple[int, ...]:
        """How many digits each parameter's values are written with: no two ends of an interval look equal."""
        return tuple(
            max(digits_between(low, high, least=4) for low, high in (interval, linear) if np.isfinite(low))
            for interval, linear in zip(self.interval.T, self.linear.T, strict=True)
        )

    def called(self, how: str) -> tuple[str, ...]:
        """Return the parameters of a kind."""
        return tuple(name for name, known in zip(self.names, self.known, strict=True) if known == how)


def noise_sentence(noise: Mapping[str, Any], unit: str) -> str:
    """State the noise model.

    Args:
        noise: Kind and numbers.
        unit: Unit of a difference of the first output.
    """
    m, n = count(noise["n_samples"], "sample"), count(noise["n_independent"])
    size = f"{significant(noise['deviation'])} {unit}".strip()
    if noise["kind"] == "sensor":
        worth = "all independent" if noise["n_independent"] == noise["n_samples"] else f"worth {n}"
        return (
            f"Noise model: the sensor's declared uncertainty, {size} as one standard deviation; {m}, {worth}."
        )
    if noise["kind"] == "white":
        return f"Noise model: white, {size} as the residuals scatter; {m}, all independent."
    if noise["n_independent"] > UNCORRELATED * noise["n_samples"]:
        return f"Noise model: {size} as the residuals scatter; they do not follow each other, {m} count."
    return (
        f"Noise model: {size} as the residuals scatter; they follow each other (first-order autoregressive), "
        f"so {m} are worth {n} independent."
    )


def sentences(record: UncertaintyRecord, units: tuple[str, ...]) -> tuple[str, ...]:
    """Say plainly what the data determine and what they do not.

    Args:
        record: The uncertainty.
        units: Unit of each output as declared.
    """
    r, unit = record, difference_unit(units[0])
    said = [noise_sentence(r.noise, unit)]
    rms = math.sqrt(r.best_mse)
    doubtful = misfit_threshold(r.sensor)
    if r.noise["kind"] != "sensor" and doubtful is not None and r.best_mse > doubtful:
        said[0] += (
            f" The best fit is off by {significant(rms / r.sensor)} times the sensor's uncertainty: rather a "
            "failed fit, or a model that lacks something, than noise. All that follows takes it for noise."
        )
    kinds = (
        ("determined", "The data determine {names}."),
        ("narrowed", "They narrow down {names}."),
        ("open", "They say next to nothing about {names}: any value in the bounds fits as well."),
        ("prior", "They leave {names} about as uncertain as the prior did."),
    )
    for kind, text in kinds:
        if names := r.called(kind):
            said.append(text.format(names=listed(names)))
    if r.is_trusted and not r.called("determined"):
        said.insert(1, "The data determine no parameter on its own.")
    said += [f"{pair}." for pair in r.pairs]
    if r.is_trusted:
        said += [
            f"Near the calibrated point moving these together hardly changes any output: {direction} (shares "
            "of the ranges, rounded)."
            for direction in r.null_directions
        ]
    outside = (r.calibrated < r.interval[0]) | (r.calibrated > r.interval[1])
    if r.has_prior and r.noise["kind"] != "sensor" and outside.any():
        which = listed(name for name, is_out in zip(r.names, outside, strict=True) if is_out)
        said.append(
            f"The calibrated {which} may lie outside: a calibration weighs priors by the sensor's "
            "uncertainty, and here the noise is as large as the residuals; --noise sensor weighs both alike."
        )
    if r.best_mse < FITS_BETTER * r.mse:
        said.append(
            f"A simulated set fits better than the calibration: MSE {significant(r.best_mse)} instead of "
            f"{significant(r.mse)} {squared(unit)}; calibrate with --from-stored begins with it."
        )
    # What nothing below may be trusted without comes first.
    said.insert(len(said) if r.is_trusted else 0, sample_sentence(r))
    return tuple(said)


def sample_sentence(record: UncertaintyRecord) -> str:
    """Say what the sample is worth and what it cost."""
    r, ledger = record, record.ledger
    if ledger.get("by_equations"):
        cost = f"{count(ledger['total'], 'model call')}; the model's state equations gave the rest"
    else:
        cost = (
            f"{count(ledger['total'], 'model call')}: {ledger['n_differences']} differences, "
            f"{ledger['n_taught']} that taught the surrogate, {ledger['n_sample']} of the sample; "
            f"{count(ledger['n_known'], 'simulation')} stored before taught it, too"
        )
    worth = (
        f"The sample of {count(len(r.weights), 'simulated parameter set')} is worth {r.n_effective:.0f} of "
        f"equal weight ({cost})."
    )
    if not r.is_trusted:
        worth += (
            " That is too few: the surrogate does not know the posterior yet, so no interval is given but "
            "the linearised ones, and bands are not to be trusted; go on with more --max-calls, and see "
            "whether a prior contradicts the data."
        )
    return worth
