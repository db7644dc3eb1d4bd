"""Trajectories: shapes, failures, selection."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from simulation import Trajectories

any_float = st.floats(allow_nan=True, allow_infinity=True)
batches = st.integers(1, 4).flatmap(
    lambda n: st.tuples(
        arrays(np.float64, (n, 2), elements=any_float), arrays(np.float64, (n, 3, 2), elements=any_float)
    )
)


def _trajectories(theta: np.ndarray, y: np.ndarray, failures: list[str] | None = None) -> Trajectories:
    return Trajectories.checked(
        theta,
        y,
        time=np.array([0.0, 1.0, 2.0]),
        parameter_names=("a", "b"),
        output_names=("T", "q"),
        failures=failures,
    )


@settings(deadline=None)
@given(batches)
def test_a_row_is_good_and_finite_or_failed_and_nan_throughout(batch: tuple[np.ndarray, np.ndarray]):
    answer = _trajectories(*batch)
    good = np.isfinite(batch[0]).all(axis=1) & np.isfinite(batch[1]).all(axis=(1, 2))
    assert np.array_equal(answer.failed, ~good)
    assert np.isnan(answer.y[answer.failed]).all()
    assert np.array_equal(answer.y[good], batch[1][good])


def test_reasons_name_the_first_fault():
    y = np.zeros((4, 3, 2))
    y[1, 2, 1] = np.inf
    theta = np.zeros((4, 2))
    theta[2, 1] = np.nan
    answer = _trajectories(theta, y, ["", "", "", "given"])
    assert answer.failures == ("", "output q is inf at 2 s", "parameter b is nan", "given")


def test_taking_and_concatenating_are_inverse():
    rng = np.random.default_rng(0)
    whole = _trajectories(rng.random((6, 2)), rng.random((6, 3, 2)), ["", "x", "", "", "y", ""])
    parts = [whole.take([0, 1]), whole.take([]), whole.take(np.arange(6) >= 2)]
    assert Trajectories.concatenate(parts).digest == whole.digest
    assert whole.take([4, 1]).failures == ("y", "x")
