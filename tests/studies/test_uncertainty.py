"""How sure a calibration is, on models whose posterior is known."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from simulation.counting import CountingModel
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.differences import difference_rows
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem
from studies.calibration.uncertainty.annealing import Reference, sample_density
from studies.calibration.uncertainty.assess import Assessment, assess, sampling_within
from studies.calibration.uncertainty.bands import bands_of, share_within
from studies.calibration.uncertainty.findings import compensations, knowledge
from studies.calibration.uncertainty.identifiability import judged
from studies.calibration.uncertainty.noise import noise_of
from studies.calibration.uncertainty.sample import Sampling

TIME = np.linspace(0.0, 1.0, 60)
SIGMA = 0.05


@dataclass(frozen=True, eq=False)
class Formula:
    """y = f(theta, t)."""

    parameter_space: ParameterSpace
    f: Callable
    time: np.ndarray = field(default_factory=lambda: TIME)
    output_names: tuple[str, ...] = ("y",)

    def simulate(self, theta):
        y = self.f(theta.T[:, :, None], self.time)[:, :, None]
        return Trajectories(
            theta, y, self.time, self.parameter_space.names, self.output_names, ("",) * len(theta)
        )


def line():
    names = ("offset", "slope")
    return Formula(
        ParameterSpace(tuple(Parameter(n, lower=-2.0, upper=2.0) for n in names)),
        lambda theta, t: theta[0] + theta[1] * t,
    )


def product():
    """Two parameters that act only through their product, and a third one."""
    return Formula(
        ParameterSpace(tuple(Parameter(n, lower=0.2, upper=5.0, scale="log") for n in "abc")),
        lambda theta, t: theta[0] * theta[1] * t + theta[2] * t**2,
    )


def posed(model, theta, seed=1, sigma=SIGMA, uncertainty=SIGMA):
    y = model.simulate(np.array([theta])).y[0]
    y = y + sigma * np.random.default_rng(seed).standard_normal(y.shape)
    measurement = Measurement.on_grid(model.time, y, model.output_names, np.array([uncertainty]))
    return CalibrationProblem(model, measurement)


def least_squares(problem):
    """The best parameters of the line, in closed form."""
    design = np.column_stack([np.ones_like(TIME), TIME])
    return np.linalg.lstsq(design, problem.measurement.y[:, 0], rcond=None)[0], design


def assessed(problem, theta, kind="white", max_calls=60, n_particles=1200) -> Assessment:
    theta = np.array(theta)
    y = problem.model.simulate(theta[None]).y[0]
    noise = noise_of(kind, problem.measurement, y, len(theta))
    return assess(
        problem, theta, y, noise=noise, known=None,
        sampling=replace(sampling_within(max_calls, len(theta)), n_particles=n_particles), seed=0,
    )  # fmt: skip


def test_a_linear_models_posterior_is_the_textbook_one():
    problem = posed(line(), [0.3, -0.4])
    best, design = least_squares(problem)
    found = assessed(problem, best, kind="sensor")
    expected = SIGMA**2 * np.linalg.inv(design.T @ design)
    theta = problem.space.from_unit(found.sample.particles)
    deviation = np.sqrt(np.diag(expected))
    # A thousand points know a mean to 3 % of the deviation, a variance to 5 %.
    assert np.abs(theta.mean(axis=0) - best) == pytest.approx(0.0, abs=0.15 * deviation.min())
    assert np.cov(theta.T) == pytest.approx(expected, rel=0.15)
    # The linearised interval is exact here.
    assert problem.space.from_unit(found.linear) == pytest.approx(
        np.stack([best - 1.645 * deviation, best + 1.645 * deviation]), rel=1e-3, abs=0.02 * deviation.min()
    )
    # The surrogate knows a linear model: one batch finds no more, and the sample counts in full.
    assert found.sample.n_taught == Sampling.n_batch
    assert found.sample.n_effective > 0.95 * len(found.sample.weights)
    assert found.n_calls == 2 * 2 + Sampling.n_batch + len(found.sample.weights)


def judged_with(emulator, max_calls=100):
    problem, theta = posed(product(), [1.5, 0.7, 1.2]), np.array([1.5, 0.7, 1.2])
    counted = CountingModel(problem.model)
    y = problem.model.simulate(theta[None]).y[0]
    noise = noise_of("sensor", problem.measurement, y, 3)
    found = assess(
        problem.on(counted), theta, y, noise=noise, known=None,
        sampling=sampling_within(max_calls, 3), seed=0, emulator=emulator,
    )  # fmt: skip
    assert found.n_calls == counted.n_calls
    return found


def test_a_emulator_that_is_right_leaves_the_model_the_sample_alone():
    found, alone = judged_with(product()), judged_with(None)
    assert found.by_equations
    assert not alone.by_equations
    assert found.n_calls == len(found.sample.weights) == Sampling.n_sample < alone.n_calls - 6
    assert found.sample.n_effective > 0.5 * Sampling.n_sample
    assert found.local.singular_values == pytest.approx(alone.local.singular_values, rel=1e-9)
    assert found.interval == pytest.approx(alone.interval, abs=0.06)
    assert judged_with(product(), max_calls=30).n_calls == 30 - 6


def test_a_emulator_that_is_wrong_is_found_out_and_what_it_cost_is_counted():
    bent = replace(product(), f=lambda theta, t: theta[0] * theta[1] * t + (theta[2] + 0.3) * t**2)
    found, alone = judged_with(bent), judged_with(None)
    assert not found.by_equations
    assert found.n_differences == 6
    assert found.sample.n_taught >= Sampling.n_batch
    assert found.interval == pytest.approx(alone.interval, abs=0.06)


def test_a_product_is_known_and_its_factors_are_not():
    problem = posed(product(), [2.0, 0.7, 1.5], sigma=0.02, uncertainty=0.02, seed=0)
    found = assessed(problem, [2.0, 0.7, 1.5], kind="sensor", max_calls=100)
    space = problem.space
    known = knowledge(space, found.sample.particles, found.local.determined)
    assert space.names[2:] == tuple(n for n, k in known.items() if k == "determined")
    pair = compensations(space, found.sample.particles)[0]
    assert (pair.first, pair.second, pair.known) == ("a", "b", "product")
    assert "compensate each other: only their product is known, to " in pair.in_words
    # The posterior is the hyperbola a b = 1.4 from bound to bound, as even in log a as the bounds allow: a
    # from 0.28 to 5, so that its 90 % interval leaves 5 % of that logarithm out at both ends.
    a = space.from_unit(found.sample.particles)[:, 0]
    low, high = np.log(1.4 / 5.0), np.log(5.0)
    ends = np.log(np.quantile(a, [0.05, 0.95]))
    assert ends == pytest.approx(
        [low + 0.05 * (high - low), high - 0.05 * (high - low)], abs=0.06 * (high - low)
    )
    simulated = found.sample.drawn.theta
    products = simulated[:, 0] * simulated[:, 1]
    heavy = found.sample.weights > 0.2 / len(products)
    assert products[heavy] == pytest.approx(1.4, rel=0.15)
    assert simulated[heavy, 0].max() / simulated[heavy, 0].min() > 5.0
    assert found.sample.n_effective > 0.3 * len(products)
    assert found.n_calls <= 100


def test_ninety_percent_intervals_hold_the_truth_nine_times_in_ten():
    rng = np.random.default_rng(5)
    n, held = 300, np.zeros(2)
    model = line()
    for seed in range(n):
        truth = rng.uniform(-1.0, 1.0, 2)
        problem = posed(model, truth, seed=seed)
        best, _ = least_squares(problem)
        y = model.simulate(best[None]).y[0]
        noise = noise_of("white", problem.measurement, y, 2)
        around = problem.evaluate(difference_rows(problem.space.to_unit(best), 0.01))
        spread = judged(problem.space.names, around, noise.raised, 0.01).spread
        held += np.abs(problem.space.to_unit(truth) - problem.space.to_unit(best)) <= 1.645 * spread
    # Three standard deviations of so many coin tosses are 0.05.
    assert held / n == pytest.approx(0.9, abs=0.05)


@pytest.mark.parametrize(("rho", "n_fitted"), [(0.0, 14), (0.9, 7)])
def test_what_fitted_parameters_took_from_the_noise_is_put_back(rho, n_fitted):
    m, rng = 481, np.random.default_rng(5)
    basis = np.cos(np.pi * np.outer(np.arange(n_fitted), np.arange(m) + 0.5) / m)
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    measurement = Measurement.on_grid(np.arange(m) * 1.0, np.zeros((m, 1)), ("y",), np.array([1.0]))
    found = []
    for _ in range(60):
        noise = rng.standard_normal(m)
        for i in range(1, m):
            noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
        left = noise - basis.T @ (basis @ noise)
        found.append(noise_of("correlated", measurement, left[:, None], n_fitted).raised ** 2)
    assert np.median(found) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.25)


def test_a_perfect_fit_shows_no_noise():
    problem = posed(line(), [0.3, -0.4], sigma=0.0)
    y = problem.model.simulate(np.array([[0.3, -0.4]])).y[0]
    # So it is the sensor's, whatever is asked for.
    for kind in ("correlated", "white", "sensor"):
        noise = noise_of(kind, problem.measurement, y, 2)
        assert (noise.kind, noise.deviation) == ("sensor", SIGMA)


@pytest.mark.parametrize("rate", [0.0, 30.0])
def test_many_open_parameters_are_filled_evenly(rate):
    """exp(-rate sum u) of twelve parameters, which may lie at their bounds, beside two known sums."""

    def log_density(u):
        sums = (u[:, 0] + u[:, 1] - 1.0) ** 2 + (u[:, 2] + u[:, 3] - 0.6) ** 2
        return -0.5 * sums / 0.02**2 - rate * np.sum(u[:, 4:], axis=1)

    found = sample_density(log_density, Reference.even(16), seed=0, n_particles=1000)
    mean = 1.0 / rate - 1.0 / np.expm1(rate) if rate else 0.5
    deviation = np.sqrt(1.0 / rate**2 - np.exp(rate) / np.expm1(rate) ** 2) if rate else np.sqrt(1.0 / 12.0)
    # Of a thousand independent points one mean errs by 3 % of the deviation.
    assert (found[:, 4:].mean(axis=0) - mean) / deviation == pytest.approx(0.0, abs=0.15)
    assert np.mean(found[:, 4:], axis=0).mean() == pytest.approx(mean, abs=0.03 * deviation)
    assert found[:, 4:].std(axis=0) == pytest.approx(deviation, rel=0.15)
    # The shares are those of a sum that leaves either parameter anywhere.
    assert np.quantile(found[:, 0], [0.05, 0.5, 0.95]) == pytest.approx([0.05, 0.5, 0.95], abs=0.06)
    assert np.quantile(found[:, 2], [0.05, 0.5, 0.95]) == pytest.approx([0.03, 0.3, 0.57], abs=0.06)


@pytest.mark.parametrize("narrow", [0.01, 0.03])
def test_regions_far_apart_keep_their_shares(narrow):
    """An even start loses a region that is much narrower than another: then both must be known."""
    n_parameters = 5

    def normal(u, centre, deviation):
        steps = np.sum(((u - centre) / deviation) ** 2, axis=1)
        return -0.5 * steps - n_parameters * np.log(deviation)

    def log_density(u):
        return np.logaddexp(np.log(0.3) + normal(u, 0.2, narrow), np.log(0.7) + normal(u, 0.75, 0.03))

    reference = Reference.even(n_parameters)
    if narrow < 0.03:
        reference = Reference(
            np.stack([np.full(n_parameters, 0.19), np.full(n_parameters, 0.77)]),
            3.0 * np.stack([narrow * np.eye(n_parameters), 0.03 * np.eye(n_parameters)]),
        )
    found = sample_density(log_density, reference, seed=0, n_particles=1000)
    assert np.mean(found[:, 0] < 0.5) == pytest.approx(0.3, abs=0.1)


def test_the_predictive_band_holds_the_measured_values():
    rng = np.random.default_rng(2)
    n, t = 400, 500
    y = (0.5 * rng.standard_normal((n, 1, 1))) + np.zeros((1, t, 1))
    bands = bands_of(y, np.full(n, 1 / n), np.array([1.2]), 0.9)
    # Parameters and noise together: 1.3 = hypot(0.5, 1.2).
    assert bands.predictive[:, 0, 0] == pytest.approx([-1.645 * 1.3, 1.645 * 1.3], abs=0.1)
    assert bands.simulated[:, 0, 0] == pytest.approx([-1.645 * 0.5, 1.645 * 0.5], abs=0.08)
    time = np.arange(float(t))
    measured = 1.3 * rng.standard_normal((t, 1))
    measurement = Measurement.on_grid(time, measured, ("y",), np.array([1.0]))
    assert share_within(measurement, bands.predictive, 0) == pytest.approx(0.9, abs=0.04)


def test_where_simulations_fail_few_are_asked():
    # The best offset is 0.503, and above 0.5 every simulation fails.
    cut = replace(line(), f=lambda theta, t: np.where(theta[0] <= 0.5, theta[0] + theta[1] * t, np.nan))
    problem = replace(posed(line(), [0.503, 0.5]), model=CountingModel(cut))
    found = assessed(problem, np.array([0.5, 0.5]))
    assert found.sample.n_effective >= 0.3 * found.sample.drawn.n
    failed = np.isinf(found.sample.drawn.mse)
    assert failed.mean() < 0.6


def test_a_prior_enters_as_it_is():
    """A linear model and a normal prior: the posterior is normal, its precision the sum of both."""
    problem = posed(line(), [0.3, -0.4])
    best, design = least_squares(problem)
    width = np.array([np.inf, 0.005])
    centre = np.array([np.nan, problem.space.to_unit(best)[1] + 0.01])
    weight = SIGMA**2 / len(TIME)
    problem = replace(problem, prior=Prior(centre, width, weight, len(TIME)))
    found = assessed(problem, best, kind="sensor")
    # The box is 4 wide: theta = 4 u - 2.
    of_data, of_prior = 16.0 * design.T @ design / SIGMA**2, np.diag(width**-2.0)
    covariance = np.linalg.inv(of_data + of_prior)
    mean = problem.space.to_unit(best) + covariance @ of_prior @ np.array([0.0, 0.01])
    u, deviation = found.sample.particles, np.sqrt(np.diag(covariance))
    assert (u.mean(axis=0) - mean) / deviation == pytest.approx(0.0, abs=0.15)
    assert np.cov(u.T) == pytest.approx(covariance, rel=0.15)
