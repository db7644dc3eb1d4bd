"""Adaptive calibration: few calls, exact counts, repeats, failures, and the process it rests on."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, Diary, Waves, problem_on, product_problem, rc_problem
from scipy.optimize import approx_fprime
from toy_rc import ToyRC

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from simulation.forward_model import WrappedModel
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.process import Features, ResidualProcess
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult

Surrogate = ResidualProcess | ProcessGroups
FEATURES = Features.of(ToyRC().parameter_space)
ROWS = np.random.default_rng(0).random((12, 2))
SHORT = Adaptive(max_calls=60)
# Differences of 1e-6 in the cube leave about 1e-6 of the gradient.
GRADIENT_RTOL = 1e-4


def test_finds_the_product_where_only_the_product_shows() -> None:
    found = SHORT.minimize(product_problem(), seed=0)
    assert found.theta.prod() == pytest.approx(TRUE_RC.prod(), rel=1e-2)


def test_reaches_its_target_in_fewer_calls_than_differences_would() -> None:
    problem = rc_problem(noise=0.05)
    best = problem.mse(problem.space.to_unit(TRUE_RC))[0]
    found = Adaptive(max_calls=20, target_mse=1.05 * best).minimize(problem, seed=1)
    assert found.converged
    assert found.stop_reason == "the target is reached"


class Diverges(WrappedModel):
    """A model whose simulations blow up for most values of its first parameter."""

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = self._model.simulate(theta)
        return replace(answer, y=np.where(theta[:, :1, None] > 2.0, 1e7, 1.0) * answer.y)


def test_simulations_that_have_diverged_do_not_hide_the_others() -> None:
    found = SHORT.minimize(rc_problem().on(Diverges(ToyRC())), seed=0)
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=1e-2)
    assert found.mse < 1e-4


@pytest.mark.parametrize("n_parallel", [1, 3])
def test_counts_exactly_the_rows_that_were_simulated_and_returns_the_best(n_parallel: int) -> None:
    problem = rc_problem(noise=0.05)
    diary = Diary(problem.model)
    found = Adaptive(max_calls=20, n_parallel=n_parallel).minimize(problem.on(diary), seed=1)
    assert found.n_calls == len(diary.rows) == found.history.n_calls[-1]
    assert found.n_rounds == sum(math.ceil(len(batch) / n_parallel) for batch in diary.batches)
    assert problem.space.contains(diary.rows).all()
    assert {len(batch) for batch in diary.batches[1:-1]} == {n_parallel}
    # The best of them is returned.
    mse = problem.mse(problem.space.to_unit(diary.rows))
    np.testing.assert_array_equal(found.theta, diary.rows[np.argmin(mse)])
    assert found.mse == pytest.approx(mse.min(), rel=1e-9)


@pytest.mark.parametrize("n_parallel", [1, 3])
def test_a_shorter_run_is_the_beginning_of_a_longer_one(n_parallel: int) -> None:
    asked = []
    for max_calls in (10, 16):
        problem = rc_problem(noise=0.05)
        diary = Diary(problem.model)
        settings = Adaptive(max_calls=max_calls, n_parallel=n_parallel, ftol=0.0)
        settings.minimize(problem.on(diary), seed=3)
        asked.append(diary.rows)
    np.testing.assert_array_equal(asked[1][:10], asked[0])


@pytest.mark.parametrize(("max_calls", "n_parallel", "n_rounds"), [(1, 1, 1), (9, 1, 9), (10, 16, 2)])
def test_never_asks_beyond_its_budget_and_says_so(max_calls: int, n_parallel: int, n_rounds: int) -> None:
    settings = Adaptive(max_calls=max_calls, n_parallel=n_parallel, ftol=0.0)
    found = settings.minimize(rc_problem(noise=0.05), seed=0)
    assert (found.n_calls, found.n_rounds) == (max_calls, n_rounds)
    assert np.isfinite(found.mse)
    assert not found.converged
    noun = "call" if max_calls == 1 else "calls"
    assert found.stop_reason == f"the budget of {max_calls} {noun} is spent"


@pytest.fixture(scope="module")
def ended() -> AdaptiveResult:
    """A search that ended by itself."""
    return SHORT.minimize(rc_problem(noise=0.05), seed=0)


def test_stops_when_nothing_more_is_expected(ended: AdaptiveResult) -> None:
    found = ended
    assert found.converged
    assert found.n_calls < 60
    assert found.expected_gain <= SHORT.ftol
    assert re.fullmatch(
        r"the search expects at most 2 % less error anywhere within the bounds; \d+ rounds of checks and "
        r"\d restarts gained less than 1 % of the error",
        found.stop_reason,
    )
    assert not found.left


def test_what_fits_exactly_is_an_end() -> None:
    found = SHORT.minimize(rc_problem(), seed=0)
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=1e-2)
    assert found.mse < 1e-4
    assert found.converged
    assert found.n_calls < 40
    assert re.fullmatch(
        r"the best simulation fits within [\d.e-]+ of the sensor's uncertainty \(RMS\)", found.stop_reason
    )
    # A sensor that would see what is left says that this is no answer.
    fine = problem_on(ToyRC(), TRUE_RC, uncertainty=np.array([1e-9]))
    beyond = SHORT.minimize(fine, seed=0)
    assert not beyond.converged
    assert beyond.n_calls == found.n_calls
    wanted = Adaptive(max_calls=found.n_calls + 2, target_mse=0.0).minimize(rc_problem(), seed=0)
    assert wanted.n_calls == found.n_calls + 2


def test_a_target_is_sought_until_the_budget_is_spent_and_its_miss_is_said(ended: AdaptiveResult) -> None:
    n = ended.n_calls + 2
    # An error that is too large ends no such search either.
    settings = Adaptive(max_calls=n, target_mse=1e-9, misfit_threshold=1e-9)
    found = settings.minimize(rc_problem(noise=0.05), seed=0)
    assert not found.converged
    assert found.n_calls == n
    assert found.stop_reason == f"the budget of {n} calls is spent; the target of 1e-09 is missed"
    assert found.left


def test_a_search_that_has_to_stop_says_what_may_be_left() -> None:
    left = [replace(SHORT, max_calls=n).minimize(rc_problem(noise=0.05), seed=0).left for n in (3, 6, 18)]
    assert left[0] == "the first simulations are not finished; a larger --max-calls goes on with them"
    assert re.fullmatch(
        r"the last \d simulations gained [\d.e+]+ % of the error.*; .* goes on from the best point", left[1]
    )
    assert re.fullmatch(
        r"near the best .* \(\d of 4 rounds of checks and \d of 3 restarts are done\); .*", left[2]
    )


def test_an_error_that_is_too_large_stops_a_search_as_early_and_is_named(ended: AdaptiveResult) -> None:
    large = replace(SHORT, misfit_threshold=1e-9).minimize(rc_problem(noise=0.05), seed=0)
    assert not large.converged
    assert large.n_calls == ended.n_calls < 60
    assert "more than the sensor's uncertainty explains" in large.stop_reason
    assert "the model misses an effect" in large.left


def test_an_error_that_is_too_large_is_no_convergence_where_valleys_may_hide() -> None:
    found = replace(SHORT, misfit_threshold=1e-9).minimize(
        problem_on(Waves(), np.array([1.3]), noise=0.1), seed=0
    )
    assert not found.converged
    assert "there may be a better minimum" in found.left


def test_ends_at_the_edge_when_the_optimum_cannot_be_simulated() -> None:
    problem = problem_on(ToyRC(), TRUE_RC).on(ToyRC(fails_above_r=1.2))
    found = Adaptive(max_calls=30).minimize(problem, seed=0)
    assert 0.9 * 1.2 <= found.theta[0] <= 1.2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_calls": 0}, "max_calls is 0; give a whole number of at least 1"),
        ({"max_calls": 10.5}, "max_calls is 10.5; give a whole number of at least 1"),
        ({"ftol": math.nan}, "ftol is nan; give at least 0"),
        ({"target_mse": -1.0}, "target_mse is -1.0; give at least 0"),
    ],
)
def test_useless_settings_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Adaptive(**settings)  # type: ignore[arg-type]


def test_where_nothing_succeeds_the_first_failure_is_named() -> None:
    found = SHORT.minimize(rc_problem().on(ToyRC(fails_above_r=0.0)), seed=0)
    assert found.mse == math.inf
    assert re.fullmatch(
        "no simulation succeeded, the first one: R = .* K/W is above 0; the budget .*", found.stop_reason
    )


def test_what_is_no_problem_is_refused() -> None:
    with pytest.raises(InputError, match=r"needs CalibrationProblem\(model, measurement\), not ToyRC"):
        SHORT.minimize(ToyRC(), seed=0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="a model needs parameter_space, and Measurement has none"):
        CalibrationProblem(rc_problem().measurement, rc_problem().measurement)  # type: ignore[arg-type]


@pytest.mark.parametrize("surrogate", [ResidualProcess, ProcessGroups])
@pytest.mark.parametrize("caution", [0.0, 0.3])
def test_the_gradient_is_that_of_the_value(surrogate: type[Surrogate], caution: float) -> None:
    process = surrogate.fit(FEATURES, ROWS, rc_problem(noise=0.05).residuals(ROWS))
    for point in np.random.default_rng(5).random((5, 2)):
        numeric = approx_fprime(point, lambda v: process.expand(v, caution).value, 1e-7)
        gradient = process.expand(point, caution).gradient
        np.testing.assert_allclose(gradient, numeric, rtol=GRADIENT_RTOL, atol=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize("surrogate", [ResidualProcess, ProcessGroups])
def test_many_points_are_predicted_as_single_ones_are(surrogate: type[Surrogate]) -> None:
    process = surrogate.fit(FEATURES, ROWS, rc_problem(noise=0.05).residuals(ROWS))
    points = np.random.default_rng(5).random((6, 2))
    alone = [process.expand(point, 1.0) for point in points]
    np.testing.assert_allclose(process.errors(points), [one.mse for one in alone], rtol=1e-8)
    variances = np.diag(process.covariance(points))
    np.testing.assert_allclose(variances, [one.value - one.mse for one in alone], rtol=1e-5)


def test_small_components_have_lengths_of_their_own() -> None:
    """A large component that follows the first parameter, and a small one that follows the second."""
    rng = np.random.default_rng(0)
    u, fresh = rng.random((25, 2)), rng.random((50, 2))

    def residuals(at: FloatArray) -> FloatArray:
        return np.stack([30.0 * np.sin(5.0 * at[:, 0]), 0.3 * np.sin(5.0 * at[:, 1]), np.zeros(len(at))], 1)

    features = Features(np.empty(0), np.zeros(2, dtype=np.bool_), np.ones(2, dtype=np.bool_))
    error = {}
    for surrogate in (ResidualProcess, ProcessGroups):
        process = surrogate.fit(features, u, residuals(u))
        predicted = np.array([process.expand(point, 0.0).mse for point in fresh])
        error[surrogate] = np.median(np.abs(predicted - np.mean(residuals(fresh) ** 2, axis=1)))
    assert error[ProcessGroups] < 0.8 * error[ResidualProcess], error


def test_an_experiment_depends_on_its_own_parameters_alone() -> None:
    """Three experiments with a common parameter, and one of its own in each."""
    rng, names = np.random.default_rng(0), ("a", "b@0", "b@1", "b@2")
    space = ParameterSpace(tuple(Parameter(name, 1.0, 10.0, scale="log") for name in names))
    u, fresh = rng.random((20, 4)), rng.random((50, 4))

    def residuals(at: FloatArray) -> FloatArray:
        own = [np.sin(4.0 * at[:, [0]] + np.arange(5.0)) * (1.0 + at[:, [k]] ** 2) for k in (1, 2, 3)]
        return np.concatenate(own, axis=1)

    def fitted(parameters: IntArray | None, columns: slice) -> ProcessGroups:
        return ProcessGroups.fit(Features.of(space, parameters), u, residuals(u)[:, columns])

    parts = [fitted(np.array([0, k + 1]), slice(5 * k, 5 * k + 5)) for k in range(3)]
    joined, together = ProcessGroups.joined(parts), fitted(None, slice(None))
    truth = np.mean(residuals(fresh) ** 2, axis=1)
    errors = [np.abs(one.errors(fresh) - truth).mean() for one in (joined, together)]
    assert errors[0] < 0.7 * errors[1], errors
    for point in fresh[:5]:
        there = joined.expand(point, 0.3)
        numeric = approx_fprime(point, lambda v: joined.expand(v, 0.3).value, 1e-7)
        atol = 1e-4 * np.abs(numeric).max()
        np.testing.assert_allclose(there.gradient, numeric, rtol=GRADIENT_RTOL, atol=atol)
        assert joined.errors(point[None])[0] == pytest.approx(there.mse)
