"""Round trips of the standardizers, constant columns, and the two error summaries."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pelsvae.metrics import errors
from pelsvae.standardize import OutputStandardizer, ThetaStandardizer

ROUND_TRIP_TOL = 1e-9  # float64 rounding, relative to the largest value in the set


@given(hnp.arrays(np.float64, (4, 3, 2), elements=st.floats(-1e6, 1e6)))
@settings(deadline=None)
def test_outputs_survive_the_round_trip(y: np.ndarray) -> None:
    standardizer = OutputStandardizer.fit(y)
    back = standardizer.physical(standardizer.standardized(y))
    np.testing.assert_allclose(back, y, rtol=0, atol=ROUND_TRIP_TOL * max(1.0, np.abs(y).max()))


def test_features_are_standardized_values_then_logarithms() -> None:
    theta = np.random.default_rng(0).uniform(1.0, 9.0, size=(40, 3))
    standardizer = ThetaStandardizer.fit(theta, np.array([True, False, True]))
    features = standardizer.features(torch.from_numpy(theta), torch.float64).numpy()
    expected = np.concatenate([theta, np.log(theta[:, [0, 2]])], axis=1)
    expected = (expected - expected.mean(axis=0)) / expected.std(axis=0)
    assert standardizer.n_features == 5
    np.testing.assert_allclose(features, expected, rtol=1e-12, atol=1e-12)


def test_constant_columns_map_to_zero() -> None:
    theta = np.tile([0.1, 3.0], (7, 1))  # the mean of seven 0.1 is not exactly 0.1
    standardizer = ThetaStandardizer.fit(theta, np.array([True, True]))
    features = standardizer.features(torch.from_numpy(theta), torch.float32)
    assert features.abs().max().item() < 1e-12
    y = np.full((7, 4, 1), 21.7)
    assert np.abs(OutputStandardizer.fit(y).standardized(y)).max() < 1e-12


def test_errors_of_a_known_case() -> None:
    true = np.zeros((11, 2, 1))
    predicted = np.arange(11.0)[:, None, None] * np.array([[1.0], [-1.0]])  # row i is off by i
    result = errors(predicted, true)
    assert (result.mae, result.p90) == (5.0, 9.0)


def test_errors_of_several_outputs_are_scaled_to_the_first_ones_unit() -> None:
    true = np.zeros((3, 4, 2))
    predicted = true + np.array([1.0, 40.0])
    result = errors(predicted, true, np.array([1.0, 0.05]))
    assert result.mae == pytest.approx(1.5)  # mean of 1 K and 40 W * 0.05 K/W
    assert result.p90 == pytest.approx(1.5)
