"""Parameters fixed by relevance: what is relevant, what fixing changes, and what it may have cost."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from problems_for_tests import Diary, FailsInBand, problem_on
from toys_for_tests import IshigamiToy

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.parameters import Belief, Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.freeing import freeing
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem
from studies.partly_fixed import PartlyFixedModel
from studies.relevance import Relevance, morris_design, morris_relevance, sobol_relevance
from studies.sensitivity import sobol_indices

WEIGHTS = np.array([3.0, 0.0, 1.0])
SPACE = ParameterSpace(
    (Parameter("much", 0.0, 1.0), Parameter("none", 0.0, 1.0), Parameter("some", 0.0, 1.0))
)


@dataclass(frozen=True)
class Weighted:
    """Three parameters of which the second does nothing."""

    parameter_space: ParameterSpace = SPACE
    output_names: tuple[str, ...] = ("y",)
    time: FloatArray = field(default_factory=lambda: np.arange(6.0))

    def simulate(self, theta: FloatArray) -> Trajectories:
        shapes = np.stack([np.sin(self.time), np.ones(6), np.cos(self.time)])
        return Trajectories.checked(
            theta,
            ((theta * WEIGHTS) @ shapes)[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


TRUTH = np.array([0.3, 0.5, 0.8])


def held(fixed: dict[str, float]) -> CalibrationProblem:
    problem = problem_on(Weighted(), TRUTH, noise=0.05)
    return replace(problem, model=PartlyFixedModel(problem.model, fixed))


def test_a_partly_fixed_model_keeps_the_promises_of_a_model() -> None:
    diary = Diary(Weighted())
    model = PartlyFixedModel(diary, {"none": 0.25})
    assert isinstance(model, ForwardModel)
    assert model.parameter_space.names == ("much", "some")
    answer = model.simulate(np.array([[0.1, 0.2], [np.nan, 0.4]]))
    np.testing.assert_array_equal(diary.rows, [[0.1, 0.25, 0.2], [np.nan, 0.25, 0.4]])
    np.testing.assert_array_equal(answer.theta, [[0.1, 0.2], [np.nan, 0.4]])
    assert answer.parameter_names == ("much", "some")
    assert answer.failed.tolist() == [False, True]
    np.testing.assert_array_equal(model.complete(np.array([0.1, 0.2])), [0.1, 0.25, 0.2])
    with pytest.raises(ValueError, match="no parameter other"):
        PartlyFixedModel(Weighted(), {"other": 1.0})


def test_only_rows_with_exactly_the_fixed_values_answer_for_the_free_ones() -> None:
    model = PartlyFixedModel(Weighted(), {"none": 0.1})
    rows = np.array([[0.2, 0.1, 0.3], [0.2, np.nextafter(0.1, 1.0), 0.3], [0.2, np.nan, 0.3]])
    assert model.holds(rows).tolist() == [True, False, False]
    np.testing.assert_array_equal(model.reduced(rows[0]), [0.2, 0.3])
    assert PartlyFixedModel(Weighted(), {}).holds(rows).all()


def test_nothing_fixed_is_the_model_itself() -> None:
    theta = np.random.default_rng(0).random((3, 3))
    model = PartlyFixedModel(Weighted(), {})
    np.testing.assert_array_equal(model.simulate(theta).y, Weighted().simulate(theta).y)
    np.testing.assert_array_equal(model.complete(theta), theta)


def test_fixing_what_does_nothing_changes_nothing() -> None:
    free = LeastSquaresTRF(ftol=1e-12).minimize(held({}), np.full(3, 0.5))
    fixed = LeastSquaresTRF(ftol=1e-12).minimize(held({"none": 0.9}), np.full(2, 0.5))
    assert fixed.mse == pytest.approx(free.mse, rel=1e-9)
    np.testing.assert_allclose(fixed.theta, free.theta[[0, 2]], atol=1e-6)
    assert fixed.n_calls < free.n_calls


def test_fixing_what_matters_costs_and_the_check_says_so() -> None:
    fixed = LeastSquaresTRF().minimize(held({"some": 0.75}), np.full(2, 0.5))
    free = LeastSquaresTRF().minimize(held({}), np.full(3, 0.5))
    assert fixed.mse > 1.2 * free.mse
    u = np.array([*fixed.u, 0.75])
    found = freeing(held({}), u, np.array([True, True, False]))
    # The model is linear and the truth within reach: the differences tell the gain exactly.
    assert found.gain == pytest.approx(1.0 - free.mse / fixed.mse, rel=1e-3)
    assert found.gain_alone[2] == pytest.approx(found.gain, rel=1e-6)
    assert found.n_calls == 4
    nothing = freeing(held({}), np.array([*free.u[:1], 0.1, *free.u[2:]]), np.array([True, False, True]))
    assert nothing.gain == pytest.approx(0.0, abs=1e-6)


def test_what_could_not_be_simulated_is_not_told_to_gain_nothing() -> None:
    problem, u, is_free = held({}), np.array([0.25, 0.5, 0.8]), np.array([False, False, True])
    both = freeing(problem, u, is_free)
    # The first parameter's difference fails; the optimum itself still succeeds.
    one_fails = freeing(problem.on(FailsInBand(problem.model, 0.255, 1.0)), u, is_free)
    assert np.isnan(one_fails.gain_alone[0])
    assert one_fails.gain_alone[1:].tolist() == both.gain_alone[1:].tolist()
    assert one_fails.gain < 0.1 < both.gain
    all_fails = freeing(problem.on(FailsInBand(problem.model, 0.0, 1.0)), u, is_free)
    assert np.isnan(all_fails.gain)
    assert np.array_equal(np.isnan(all_fails.gain_alone), ~is_free)


def test_a_prior_keeps_freed_parameters_back() -> None:
    problem = held({})
    fixed = LeastSquaresTRF().minimize(held({"some": 0.75}), np.full(2, 0.5))
    u, is_free = np.array([*fixed.u, 0.75]), np.array([True, True, False])
    much, none, some = SPACE.parameters
    sure = ParameterSpace((much, none, replace(some, prior=Belief(0.75, 1e-4))))
    known = replace(problem, prior=Prior.of(sure, problem.measurement))
    assert freeing(known, u, is_free).gain < 0.01 * freeing(problem, u, is_free).gain


def test_morris_finds_what_matters_in_the_exact_shares() -> None:
    problem = problem_on(Weighted(), TRUTH)
    diary = Diary(problem.model)
    found = morris_relevance(problem.on(diary), n_trajectories=4, seed=0)
    assert found.n_calls == len(diary.rows) == 4 * 4
    t = np.arange(6.0)
    squares = WEIGHTS**2 * np.array([np.mean(np.sin(t) ** 2), 1.0, np.mean(np.cos(t) ** 2)])
    np.testing.assert_allclose(found.shares, squares / squares.sum(), atol=1e-9)
    assert found.most(1) == ("much",)
    assert found.most(2) == ("much", "some")


def test_a_morris_design_moves_one_parameter_at_a_time_and_follows_its_seed() -> None:
    u = morris_design(5, 3, 0)
    assert u.shape == (18, 5)
    for trajectory in u.reshape(3, 6, 5):
        moved = np.abs(np.diff(trajectory, axis=0)) > 0
        assert (moved.sum(axis=1) == 1).all()
        assert moved.any(axis=0).all()
    np.testing.assert_array_equal(u, morris_design(5, 3, 0))
    assert (u != morris_design(5, 3, 1)).any()


def test_a_parameter_that_could_not_be_simulated_counts_as_relevant() -> None:
    shares = Relevance(("a", "b", "c"), np.array([0.9, np.nan, 0.1]), "Morris", 8)
    assert shares.most(2) == ("a", "b")


def test_sobol_shares_are_weighed_by_variance() -> None:
    toy = IshigamiToy()
    indices = sobol_indices(toy, n_base=512, seed=0)
    measurement = Measurement.on_grid(
        toy.time, toy.simulate(np.zeros((1, 3))).y[0], toy.output_names, np.array([1.0])
    )
    found = sobol_relevance(indices, measurement)
    assert found.shares.sum() == pytest.approx(1.0)
    assert found.source == "Sobol"
    # Ishigami: the second has the largest share early on, x3 acts through the first alone.
    assert found.most(2) == ("x1", "x2")
