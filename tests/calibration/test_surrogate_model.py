"""A surrogate keeps the promises of a forward model."""

import numpy as np
import pytest
from toy_rc import ToyRC

from pelsvae.config import SurrogateConfig
from pelsvae.training import fit
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from studies.surrogate_model import SurrogateModel


@pytest.fixture(scope="module")
def surrogate_model() -> SurrogateModel:
    toy = ToyRC()
    space = toy.parameter_space
    sets = [toy.simulate(uniform_design(space, n, seed)) for n, seed in ((256, 1), (64, 2))]
    config = SurrogateConfig(
        n_latent=4, n_hidden=32, n_layers=2, theta_features="linear+log", max_epochs=150, device="cpu"
    )
    validation = (sets[1].theta, sets[1].y)
    fitted = fit(sets[0].theta, sets[0].y, validation, config=config, seed=0, log_columns=space.is_log)
    return SurrogateModel(fitted.surrogate, space, toy.output_names, toy.time)


def test_it_is_a_forward_model_that_resembles_what_it_learned(surrogate_model: SurrogateModel) -> None:
    assert isinstance(surrogate_model, ForwardModel)
    theta = uniform_design(surrogate_model.parameter_space, 50, 3)
    answer, truth = surrogate_model.simulate(theta), ToyRC().simulate(theta)
    assert not answer.failed.any()
    assert (answer.parameter_names, answer.output_names) == (truth.parameter_names, truth.output_names)
    assert np.abs(answer.y - truth.y).mean() < 0.3 * np.abs(truth.y - truth.y.mean(axis=0)).mean()


def test_a_bad_row_fails_alone(surrogate_model: SurrogateModel) -> None:
    theta = np.array([[1.0, 1e4], [np.nan, 1e4], [-1.0, 1e4], [2.0, 2e4]])
    answer = surrogate_model.simulate(theta)
    np.testing.assert_array_equal(answer.failed, [False, True, True, False])
    assert "R is nan" in answer.failures[1]
    assert "not positive" in answer.failures[2]
    np.testing.assert_allclose(answer.y[[0, 3]], surrogate_model.simulate(theta[[0, 3]]).y, atol=1e-4)


def test_a_surrogate_of_another_window_is_refused_in_one_line(surrogate_model: SurrogateModel) -> None:
    longer = SurrogateModel(
        surrogate_model.surrogate, surrogate_model.parameter_space, ("T",), np.arange(30) * 3600.0
    )
    with pytest.raises(
        InputError, match="predicts 25 times of 1 outputs, the case has 30 of 1; tune it again"
    ):
        longer.simulate(np.array([[1.0, 1e4]]))
