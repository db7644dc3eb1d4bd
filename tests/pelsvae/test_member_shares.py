"""Shares of members in a mean: against a general solver, at their limits, and when members must go."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from pelsvae.member_shares import BELIEF, best_shares

Array = npt.NDArray[np.float64]


def members(n_rows: int, n_members: int, seed: int = 0) -> tuple[Array, Array]:
    """Return what members of different worth predict, (m, b, 2), and the truth, (b, 2)."""
    random = np.random.default_rng(seed)
    true = random.normal(size=(n_rows, 2))
    noise = np.linspace(0.2, 1.0, n_members)[:, None, None] * random.normal(size=(n_members, n_rows, 2))
    return true + noise, true


def test_shares_are_those_of_a_general_solver() -> None:
    predicted, true = members(50, 4)
    believed = np.repeat([[0.4], [0.3], [0.2], [0.1]], 2, axis=1)
    share = best_shares(predicted, true, believed, 4).share
    for code in range(2):
        left = true[:, code] - predicted[:, :, code]
        noise = np.square(believed[:, code] @ left).mean()

        def cost(
            w: Array, left: Array = left, noise: float = noise, start: Array = believed[:, code]
        ) -> float:
            return float(np.square(w @ left).sum() / noise + BELIEF * np.square(w - start).sum())

        found = minimize(
            cost,
            believed[:, code],
            bounds=[(0.0, 1.0)] * 4,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0},
            options={"ftol": 1e-12},
        )
        np.testing.assert_allclose(share[:, code], found.x, atol=1e-5)


def test_members_that_matter_least_are_left_out() -> None:
    predicted, true = members(300, 9)
    chosen = best_shares(predicted, true, np.full((9, 2), 1.0 / 9.0), 3)
    assert chosen.members.tolist() == [0, 1, 2]
    np.testing.assert_allclose(chosen.share.sum(axis=0), 1.0)
    assert (chosen.share >= 0.0).all()
