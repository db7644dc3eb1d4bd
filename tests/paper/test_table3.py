"""Optimizers straight on the model: what is counted, and how starts are drawn."""

from dataclasses import replace

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation.counting import CountingModel
from simulation.measurement import Measurement
from studies.paper.fig8 import largest_clusters
from studies.paper.table3 import Row, minimize_from, start_points

TRUTH = np.array([[1.7, 2.3e4]])
ROWS = [
    Row("LS-TRF", tolerance=1e-6),
    Row("LS-TRF", in_unit_cube=True),
    Row("SLSQP", in_unit_cube=True),
    Row("Nelder-Mead", in_unit_cube=True, max_calls=80),
    Row("Powell", in_unit_cube=True, max_calls=300),
    Row("Differential evolution", max_calls=1500),
]


def toy_measurement(noise: float = 0.05) -> Measurement:
    model = ToyRC()
    y = model.simulate(TRUTH).y[0]
    y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
    return Measurement.on_grid(model.time, y, model.output_names, np.array([0.5]))


def test_starts_begin_with_the_guess_stay_in_the_box_and_extend_each_other() -> None:
    space = ToyRC().parameter_space
    row = Row("Powell", 40, seed=2)
    starts = start_points(space, row)
    assert starts[0].tolist() == [1.0, 1e4]
    assert space.contains(starts).all()
    assert np.array_equal(start_points(space, replace(row, n_starts=7)), starts[:7])
    assert not np.array_equal(start_points(space, replace(row, seed=1))[1:], starts[1:])


@pytest.mark.parametrize("row", ROWS, ids=[row.title for row in ROWS])
def test_calls_are_those_the_model_was_asked_and_the_error_is_that_of_the_point(row: Row) -> None:
    measurement, counter = toy_measurement(), CountingModel(ToyRC())
    theta0 = start_points(counter.parameter_space, row)[0]
    found = minimize_from(counter, measurement, row, theta0)
    assert found.n_calls == counter.n_calls
    assert row.max_calls is None or found.n_calls <= row.max_calls
    theta = np.array([found.theta])
    assert found.mse == pytest.approx(measurement.mse(ToyRC().simulate(theta).y)[0], rel=1e-12)
    # 1 % above the noise, whatever the method.
    truth = measurement.mse(ToyRC().simulate(TRUTH).y)[0]
    assert found.mse <= 1.01 * truth


@pytest.mark.parametrize("method", ["Nelder-Mead", "SLSQP", "LS-TRF"])
def test_rows_that_fail_are_bad_and_end_nothing(method: str) -> None:
    row = Row(method, in_unit_cube=True)  # type: ignore[arg-type]
    found = minimize_from(ToyRC(fails_above_r=1.8), toy_measurement(), row, np.array([1.0, 1e4]))
    assert found.mse < 0.1
    assert found.theta[0] <= 1.8


def test_clusters_are_found_the_largest_first() -> None:
    rng = np.random.default_rng(1)
    groups = [center + 0.01 * rng.standard_normal((n, 2)) for center, n in ((0.2, 5), (0.8, 20), (0.5, 11))]
    found = largest_clusters(np.concatenate(groups), 3)
    assert [len(one) for one in found] == [20, 11, 5]
    assert found[0].mean() == pytest.approx(0.8, abs=0.02)
    assert len(largest_clusters(np.ones((4, 2)), 3)) == 1
