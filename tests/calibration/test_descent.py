"""Walks downhill: where nothing can be solved they end, and where a solution takes long there are fewer."""

import numpy as np

from studies.calibration.descent import Descents, descend_together


def test_a_walk_whose_slopes_cannot_be_solved_ends_where_it_began() -> None:
    """Only the start itself has finite residuals; no points are asked for in an empty list."""
    start = np.array([[0.3, 0.4]])

    def residuals(u: np.ndarray) -> np.ndarray:
        assert len(u)
        return np.where((u == start).all(axis=1, keepdims=True), 1.0, np.nan)

    ends, values = descend_together(residuals, None, start)
    assert np.array_equal(ends, start)
    assert np.array_equal(values, [1.0])


def test_a_share_of_the_walks_asks_for_a_share_of_the_solutions() -> None:
    n_asked = []
    for share in (1.0, 0.1):
        asked: list[int] = []

        def residuals(u: np.ndarray, asked: list[int] = asked) -> np.ndarray:
            asked.append(len(u))
            return np.sin(9.0 * u) - 0.3

        looks = np.random.default_rng(0).random((400, 3))
        descents = Descents(None, 3, 20)
        for _ in range(2):
            _, values = descents.lowest(residuals, looks, looks[:5], share=share)
        assert values[0] < 1e-9
        n_asked.append(sum(asked))
    assert n_asked[1] < 0.25 * n_asked[0]
