"""Minimizations that wait for each other find what each would find alone."""

import threading
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from pelsvae.minimize_in_step import minimize_in_step

Array = npt.NDArray[np.float64]
BOUNDS = [(-2.0, 2.0), (-2.0, 2.0)]
STARTS = [np.array([-1.2, 1.0]), np.array([0.0, 0.0]), np.array([1.9, -1.9]), np.array([0.7, 0.5])]
STEEPNESS = np.array([100.0, 10.0, 1.0, 30.0])


def rosenbrock(which: list[int], points: Array) -> tuple[Array, Array]:
    """Rosenbrock's valley, of another steepness for each."""
    steep, x, y = STEEPNESS[which], points[:, 0], points[:, 1]
    beside = y - x**2
    gradient = np.stack([-4.0 * steep * x * beside - 2.0 * (1.0 - x), 2.0 * steep * beside], axis=1)
    return steep * beside**2 + (1.0 - x) ** 2, gradient


def only(place: int) -> Callable[[list[int], Array], tuple[Array, Array]]:
    return lambda _, points: rosenbrock([place], points)


def test_each_finds_its_minimum_as_alone_and_they_are_asked_together() -> None:
    asked: list[list[int]] = []

    def losses(which: list[int], points: Array) -> tuple[Array, Array]:
        asked.append(which)
        return rosenbrock(which, points)

    found = minimize_in_step(losses, STARTS, BOUNDS, 100)
    assert asked[:5] == [[0, 1, 2, 3]] * 5
    assert len(asked) == max(sum(place in which for which in asked) for place in range(4))
    for place, start in enumerate(STARTS):
        alone = minimize_in_step(only(place), [start], BOUNDS, 100)
        assert found[place][0] == alone[0][0]
        np.testing.assert_array_equal(found[place][1], alone[0][1])
        np.testing.assert_allclose(found[place][1], 1.0, atol=1e-3)


def test_iterations_are_limited_and_the_bounds_hold() -> None:
    (early, _), *_ = minimize_in_step(rosenbrock, STARTS, BOUNDS, 2)
    (late, _), *_ = minimize_in_step(rosenbrock, STARTS, BOUNDS, 100)
    assert early > 100.0 * late
    narrow = minimize_in_step(rosenbrock, STARTS, [(-2.0, 0.5), (-2.0, 2.0)], 100)
    assert [round(float(at[0]), 6) for _, at in narrow] == [0.5] * 4


@pytest.mark.parametrize("n_answers", [0, 3])
def test_an_error_in_between_is_raised_and_no_thread_is_left(n_answers: int) -> None:
    n_left = n_answers

    def losses(which: list[int], points: Array) -> tuple[Array, Array]:
        nonlocal n_left
        if n_left == 0:
            raise KeyboardInterrupt
        n_left -= 1
        return rosenbrock(which, points)

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        minimize_in_step(losses, STARTS, BOUNDS, 100)
    assert threading.active_count() == before


def test_what_a_minimization_says_is_raised() -> None:
    with pytest.raises(ValueError, match="lower bound"):
        minimize_in_step(rosenbrock, STARTS, [(2.0, -2.0), (-2.0, 2.0)], 100)
