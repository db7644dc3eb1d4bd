"""A posterior sample drawn with the help of a model that costs nothing and is as good as the real one.

The surrogate is taught by the stand-in alone. The real model simulates the members of the sample, and each
counts as much as the real density exceeds the one that the surrogate expected. Where the real density is
another one than the stand-in's, or the sample loses its worth, there is no such sample.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.uncertainty.density import Posterior
from studies.uncertainty.rows import joined
from studies.uncertainty.sample import (
    AGREEMENT,
    OnCalls,
    PosteriorSample,
    PosteriorSampler,
    Sampling,
    agrees,
)
from studies.uncertainty.weights import normalized

SAME_DENSITY = 0.25
"""Mean difference of the two logarithmic densities, but for a constant, up to which they are the same."""

MOST_FREE = 600
"""Rows that the stand-in may be asked; a surrogate's costs grow with the third power of their number."""

CLOSER = 0.7, 0.65
"""A surrogate that is taught for nothing has to agree better; where it does not learn to, as usual."""


class StandInSample(NamedTuple):
    """What became of a sample that was drawn with a stand-in.

    Attributes:
        sample: The sample, None where the real model disagrees.
        asked: Rows that the real model was asked.
    """

    sample: PosteriorSample | None
    asked: Evaluation


def sample_with(
    stand_in: CalibrationProblem,
    problem: CalibrationProblem,
    posterior: Posterior,
    settings: Sampling,
    known: Evaluation,
    *,
    seed: int,
    on_calls: OnCalls | None = None,
) -> StandInSample:
    """Sample a posterior by a stand-in, and have the model simulate the sample.

    Args:
        stand_in: The problem, posed to the stand-in.
        problem: The same, posed to the physical model.
        posterior: The density.
        settings: How to sample; the budget is of the physical model.
        known: Rows that are known already.
        seed: Seed of all draws.
        on_calls: Told how many rows were asked of the physical model so far.
    """
    free = replace(settings, max_calls=MOST_FREE)
    for agreement in (CLOSER, AGREEMENT):
        taught = PosteriorSampler(stand_in, posterior, free, known, seed=seed, agreement=agreement).sample()
        if taught.drawn.n == settings.n_sample:
            break
    u = taught.drawn.u[: settings.max_calls]
    solved = posterior.at(u, taught.drawn.mse[: len(u)])
    expected = solved - taught.log_ratios[: len(u)]
    parts, ratios = list[Evaluation](), np.empty(0)
    while len(ratios) < len(u):
        now = slice(len(ratios), len(ratios) + settings.n_batch)
        parts.append(problem.evaluate(u[now]))
        ratios = np.append(ratios, posterior.at(u[now], parts[-1].mse) - expected[now])
        if on_calls is not None:
            on_calls(len(ratios))
        is_left = settings.max_calls - len(ratios) >= 2 * settings.n_batch
        is_same = _differ(ratios + expected[: len(ratios)] - solved[: len(ratios)]) <= SAME_DENSITY
        if is_left and not (is_same and agrees(ratios, settings.n_batch)):
            return StandInSample(None, joined(parts))
    drawn = joined(parts)
    sample = replace(
        taught,
        drawn=drawn,
        weights=normalized(ratios),
        log_ratios=ratios,
        n_calls=len(ratios),
        n_taught=0,
        n_known=known.n,
    )
    return StandInSample(sample, drawn)


def _differ(differences: FloatArray) -> float:
    """Return the mean difference of logarithms (n,) from their middle; of failed rows none is known."""
    known = differences[np.isfinite(differences)]
    return float(np.mean(np.abs(known - np.median(known)))) if known.size else np.inf
