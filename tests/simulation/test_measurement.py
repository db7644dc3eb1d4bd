"""Measurements: compared at their own times, gaps without residuals, weights, the same numbers on a grid."""

from dataclasses import replace

import numpy as np
import pytest
from measurement_for_tests import with_each, with_samples

from simulation import Measurement
from simulation.limits import Limits
from simulation.measurement import MeasuredOutput
from simulation.robust_loss import LossKind, RobustLoss
from simulation.samples import Samples

TIME = np.arange(6) * 600.0
SIGMA = np.array([0.5])


def _grid(
    y: np.ndarray, uncertainty: np.ndarray | None = None, weights: np.ndarray | None = None
) -> Measurement:
    names = tuple(f"y{k}" for k in range(y.shape[1]))
    plain = Measurement.on_grid(
        TIME, y, names, np.full(y.shape[1], 0.5) if uncertainty is None else uncertainty
    )
    weighted = zip(plain.outputs, np.ones(y.shape[1]) if weights is None else weights, strict=True)
    return replace(plain, outputs=tuple(replace(one, weight=float(weight)) for one, weight in weighted))


def _sampled(
    samples: tuple[Samples, ...], uncertainty: np.ndarray, weights: np.ndarray | None = None
) -> Measurement:
    weights = np.ones(len(samples)) if weights is None else weights
    each = zip("abc", samples, uncertainty.tolist(), weights.tolist(), strict=False)
    return Measurement(TIME, tuple(MeasuredOutput(name, "", *its) for name, *its in each))


def _rows(n: int, k: int) -> np.ndarray:
    return np.random.default_rng(3).normal(20.0, 3.0, (n, len(TIME), k))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_samples_on_all_output_times_give_the_plain_difference_bit_for_bit(k: int):
    y, sigma = _rows(1, k)[0], np.array([0.5, 3.0, 0.1])[:k]
    rows = _rows(7, k) + 1.0
    plain = ((rows - y[None]) * (np.ones(1) if k == 1 else sigma[0] / sigma)).reshape(len(rows), -1)
    measurement = _grid(y, sigma)
    np.testing.assert_array_equal(measurement.compared(rows), plain)
    np.testing.assert_array_equal(measurement.mse(rows), np.mean(plain**2, axis=1))
    np.testing.assert_array_equal(measurement.y, y)
    assert measurement.n_samples == plain.shape[1]


def test_between_output_times_the_simulated_line_is_compared():
    line = (2.0 + TIME / 100.0)[None, :, None]
    at = np.array([0.0, 150.0, 1499.0, 3000.0])
    measurement = _sampled((Samples(at, np.full(4, 5.0)),), SIGMA)
    np.testing.assert_allclose(measurement.compared(line)[0], 2.0 + at / 100.0 - 5.0, rtol=1e-14)
    assert np.isnan(measurement.y[1:5]).all()
    assert measurement.y[[0, 5], 0].tolist() == [5.0, 5.0]


def test_the_mse_is_the_formula():
    rng = np.random.default_rng(0)
    sigma, weights = np.array([0.5, 40.0, 2.0]), np.array([1.0, 3.0, 0.5])
    samples = tuple(Samples(np.sort(rng.uniform(0, 3000, m)), rng.normal(size=m)) for m in (4, 50, 7))
    measurement = _sampled(samples, sigma, weights)
    row = _rows(1, 3)
    expected = 0.0
    for k, one in enumerate(samples):
        simulated = np.interp(one.time, TIME, row[0, :, k])
        expected += (
            weights[k] / weights.sum() * np.mean((sigma[0] / sigma[k] * (simulated - one.values)) ** 2)
        )
    assert measurement.mse(row)[0] == pytest.approx(expected, rel=1e-12)
    assert np.mean(measurement.compared(row) ** 2) == pytest.approx(expected, rel=1e-12)


def test_the_digest_sees_values_times_weights_and_names():
    base = _grid(_rows(1, 2)[0])
    shifted = [Samples(one.samples.time[:-1] + 60.0, one.samples.values[:-1]) for one in base.outputs]
    others = [
        _grid(_rows(1, 2)[0] + 1e-9),
        _grid(_rows(1, 2)[0], weights=np.array([1.0, 2.0])),
        _grid(_rows(1, 2)[0], np.array([0.5, 0.6])),
        Measurement.on_grid(TIME, _rows(1, 2)[0], ("a", "b"), np.full(2, 0.5)),
        with_samples(base, shifted),
        with_samples(base, [Samples(one.time, one.values + 1.0) for one in shifted]),
    ]
    # The last two have no sample on an output time but the shifts of each other.
    assert len({one.digest for one in [base, *others]}) == 7
    assert _grid(_rows(1, 2)[0]).digest == base.digest


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: _grid(np.zeros((5, 1))), r"y \(5, 1\) does not fit; expected \(6, 1\)"),
        (lambda: _grid(np.full((6, 1), np.nan)), "without a sample"),
        (lambda: _grid(np.zeros((6, 2)), SIGMA), "do not fit 2 outputs"),
        (lambda: _grid(np.zeros((6, 1)), np.zeros(1)), r"uncertainty is \[0\.\]; .* has to be positive"),
        (lambda: Samples(np.array([1.0, 1.0]), np.zeros(2)), "do not rise"),
        (
            lambda: _sampled((Samples(np.array([0.0, 3001.0]), np.zeros(2)),), SIGMA),
            "a sample at 3001 s lies outside the output times, 0 to 3000 s",
        ),
    ],
)
def test_what_does_not_fit_is_refused(make: object, message: str):
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


LOSSES = {
    "huber": lambda d, c: d**2 if d <= c else 2.0 * c * d - c**2,
    "soft-l1": lambda d, c: 2.0 * c**2 * ((1.0 + (d / c) ** 2) ** 0.5 - 1.0),
}


@pytest.mark.parametrize("kind", LOSSES)
def test_the_error_with_a_robust_loss_is_the_formula_in_the_outputs_unit(kind: LossKind):
    rng = np.random.default_rng(1)
    sigma, weights = np.array([0.5, 40.0]), np.array([1.0, 3.0])
    samples = tuple(Samples(np.sort(rng.uniform(0, 3000, m)), rng.normal(size=m)) for m in (4, 50))
    plain = _sampled(samples, sigma, weights)
    first, second = plain.outputs
    robust = replace(plain, outputs=(first, replace(second, loss=RobustLoss(kind, 18.0))))
    rows = _rows(3, 2)
    for row, found in zip(rows, robust.mse(rows), strict=True):
        expected = 0.0
        for k, loss in enumerate((lambda d, _: d**2, LOSSES[kind])):
            differences = np.abs(plain.differences(row[None], k)[0])
            size = np.mean([loss(d, 18.0) for d in differences]) * (sigma[0] / sigma[k]) ** 2
            expected += weights[k] / weights.sum() * size
        assert found == pytest.approx(expected, rel=1e-12)
    assert (np.sign(robust.compared(rows)) == np.sign(plain.compared(rows))).all()
    np.testing.assert_allclose(
        robust.scaled_differences(robust.compared(rows)), plain.compared(rows), rtol=1e-12
    )
    assert (robust.error_name, plain.error_name) == ("mean loss", "MSE")
    assert robust.digest != plain.digest


@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize("size", [0.0, 1e-9, 0.3, 3.0, 1e6])
def test_a_loss_leaves_small_differences_as_they_are_and_can_be_undone(kind: LossKind, size: float):
    loss, d = RobustLoss(kind, 3.0), np.array([size, -size, np.nan])
    assert not np.isfinite(loss.shrunk(np.array([np.inf, -np.inf, np.nan]))).any()
    shrunk = loss.shrunk(d)
    assert shrunk[0] == -shrunk[1]
    if size < 1e-6 or (kind == "huber" and size <= 3.0):
        assert shrunk[0] == size
    assert shrunk[0] <= size
    np.testing.assert_allclose(loss.grown(shrunk), d, rtol=1e-12)


def _whitened(tau: tuple[float, float]) -> Measurement:
    rng = np.random.default_rng(2)
    samples = tuple(Samples(np.sort(rng.uniform(0, 3000, m)), rng.normal(20.0, size=m)) for m in (9, 30))
    first, second = _sampled(samples, np.array([0.5, 40.0]), np.array([1.0, 3.0])).outputs
    outputs = replace(first, correlation_s=tau[0]), replace(second, correlation_s=tau[1])
    return Measurement(TIME, outputs)


def test_squares_of_correlated_errors_are_those_of_the_likelihood():
    measurement, rows = _whitened((900.0, 0.0)), _rows(3, 2)
    at, scales = measurement.outputs[0].samples.time, measurement.scales
    likely = np.linalg.inv(np.exp(-np.abs(at[:, None] - at) / 900.0))
    for row, residuals in zip(rows, measurement.compared(rows), strict=True):
        first, second = (measurement.differences(row[None], k)[0] for k in (0, 1))
        # The output without a correlation time counts as it did.
        expected = scales[0] ** 2 * first @ likely @ first + scales[1] ** 2 * second @ second
        assert residuals @ residuals == pytest.approx(expected, rel=1e-10)
    assert measurement.error_name == "whitened MSE"


def test_scaled_differences_are_those_without_a_correlation_time():
    measurement, rows = _whitened((900.0, 4000.0)), _rows(3, 2)
    plain = with_each(measurement, correlation_s=0.0)
    found = measurement.scaled_differences(measurement.compared(rows))
    np.testing.assert_allclose(found, plain.compared(rows), rtol=1e-9)
    assert measurement.digest != plain.digest


def _limited(at_least: float, at_most: float, *, is_alone: bool) -> Measurement:
    measured = _grid(_rows(1, 2)[0], np.array([0.5, 2.0]), np.array([2.0, 3.0]))
    limits = Limits(TIME[2:], at_least, at_most, is_alone=is_alone)
    first, second = measured.outputs
    samples = Samples(TIME[2:], np.full(4, at_most)) if is_alone else first.samples
    return Measurement(TIME, (replace(first, samples=samples, limits=limits), second))


@pytest.mark.parametrize("is_alone", [False, True])
def test_only_what_lies_beyond_a_limit_counts(is_alone: bool):
    measurement, rows = _limited(18.0, 21.0, is_alone=is_alone), _rows(3, 2)
    measured = _grid(_rows(1, 2)[0]).y
    for row, error in zip(rows, measurement.mse(rows), strict=True):
        excess = [max(v - 21.0, 0.0) + max(18.0 - v, 0.0) for v in row[2:, 0]]
        first = np.mean((row[:, 0] - measured[:, 0]) ** 2)
        second = np.mean((0.5 / 2.0 * (row[:, 1] - measured[:, 1])) ** 2)
        parts = 2.0 * np.mean(np.square(excess)) + 3.0 * second + (0.0 if is_alone else 2.0 * first)
        assert error == pytest.approx(parts / (3.0 if is_alone else 5.0), rel=1e-12)
    assert measurement.measured == ((1,) if is_alone else (0, 1))
    n_times, n_limited = rows.shape[1], rows.shape[1] - 2
    of = [np.count_nonzero(measurement.output_of == k) for k in (0, 1)]
    assert of == [n_limited if is_alone else n_times + n_limited, n_times]
    assert sum(of) == measurement.n_samples
    assert (~np.isin(measurement.target_of, measurement.measured)).sum() == n_limited


def test_limits_alone_are_no_target():
    both = _limited(18.0, 21.0, is_alone=True)
    with pytest.raises(ValueError, match="no output is measured"):
        replace(both, outputs=both.outputs[:1] * 2)
