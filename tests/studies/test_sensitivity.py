"""Sobol indices against exact values, against SALib's own analysis, and the traps of both."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from SALib.analyze import sobol as salib_analyze
from SALib.sample import sobol as salib_sample
from toys_for_tests import IshigamiToy

from simulation.arrays import BoolArray, FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.sobol import SobolIndices, mean_over_time, sobol_indices


@dataclass(frozen=True)
class GFunction:
    """Sobol's g-function, with a constant output beside it and rows that may fail."""

    weights: tuple[float, ...] = (0.0, 1.0, 4.5, 9.0)
    fails_above: float = 1.0
    time: FloatArray = field(default_factory=lambda: np.array([0.0, 60.0]))
    output_names: tuple[str, ...] = ("g", "constant")

    @property
    def parameter_space(self) -> ParameterSpace:
        return ParameterSpace(tuple(Parameter(f"x{i}", 0.0, 1.0) for i in range(len(self.weights))))

    def simulate(self, theta: FloatArray) -> Trajectories:
        a = np.array(self.weights)
        g = np.prod((np.abs(4.0 * theta - 2.0) + a) / (1.0 + a), axis=1)
        y = np.stack([np.stack([np.full_like(g, 20.0), 100.0 + g], 1), np.full((len(g), 2), 3.0)], 2)
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=["too large" if row[0] > self.fails_above else "" for row in theta],
        )


def exact_ishigami(a: float, b: float) -> tuple[FloatArray, FloatArray]:
    """First and total order (Ishigami and Homma 1990; 10.1109/ISUMA.1990.151285)."""
    v1 = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2
    v2 = a**2 / 8.0
    v13 = b**2 * np.pi**8 * 8.0 / 225.0
    variance = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / variance, np.array([v1 + v13, v2, v13]) / variance


def undefined(indices: SobolIndices) -> BoolArray:
    """Return the steps at which an output does not vary. Shape (t, k)."""
    return np.isnan(indices.total_order[:, :, 0])


def test_ishigamis_exact_indices_at_every_step() -> None:
    toy = IshigamiToy()
    indices = sobol_indices(toy, n_base=4096, seed=1)
    for step, time in enumerate(toy.time):
        first, total = exact_ishigami(toy.a, toy.b * time / toy.time[-1])
        np.testing.assert_allclose(indices.first_order[step, 0], first, atol=0.02)
        np.testing.assert_allclose(indices.total_order[step, 0], total, atol=0.02)


def test_what_does_not_vary_is_undefined_and_nothing_else() -> None:
    indices = sobol_indices(GFunction(), n_base=64, seed=0)
    np.testing.assert_array_equal(undefined(indices), [[True, True], [False, True]])
    assert np.isnan(indices.first_order_ci[undefined(indices)]).all()
    assert np.isfinite(indices.first_order[1, 0]).all()
    np.testing.assert_allclose(mean_over_time(indices.first_order)[0], indices.first_order[1, 0])
    assert np.isnan(mean_over_time(indices.total_order)[1]).all()
    np.testing.assert_allclose(indices.variance[:, 1], 0.0, atol=1e-20)


@pytest.mark.parametrize("seed", [1, 7])
def test_agrees_with_salibs_own_analysis_of_every_column(seed: int) -> None:
    toy = IshigamiToy()
    indices = sobol_indices(toy, n_base=256, seed=seed, n_resamples=50)
    declared = {"num_vars": 3, "names": ["x1", "x2", "x3"], "bounds": [[-np.pi, np.pi]] * 3}
    theta = salib_sample.sample(declared, 256, calc_second_order=False, seed=seed)
    y = toy.simulate(theta).y[:, :, 0]
    for step in range(len(toy.time)):
        theirs = salib_analyze.analyze(
            declared, y[:, step], calc_second_order=False, num_resamples=50, seed=seed
        )
        np.testing.assert_allclose(indices.first_order[step, 0], theirs["S1"], atol=1e-12)
        np.testing.assert_allclose(indices.total_order[step, 0], theirs["ST"], atol=1e-12)
        np.testing.assert_allclose(indices.first_order_ci[step, 0], theirs["S1_conf"], rtol=1e-8)
        np.testing.assert_allclose(indices.total_order_ci[step, 0], theirs["ST_conf"], rtol=1e-8)


def test_seed_zero_is_a_seed() -> None:
    first, second = (sobol_indices(IshigamiToy(), n_base=64, seed=0) for _ in range(2))
    np.testing.assert_array_equal(first.total_order, second.total_order)
    np.testing.assert_array_equal(first.total_order_ci, second.total_order_ci)
    other = sobol_indices(IshigamiToy(), n_base=64, seed=1)
    assert not np.array_equal(first.total_order, other.total_order)


def test_a_failed_row_costs_its_block_not_the_analysis() -> None:
    whole = sobol_indices(GFunction(), n_base=1024, seed=0)
    holed = sobol_indices(GFunction(fails_above=0.999), n_base=1024, seed=0)
    assert 0 < holed.n_dropped < 20
    assert holed.n_calls == whole.n_calls == 1024 * 6
    np.testing.assert_allclose(holed.first_order[1, 0], whole.first_order[1, 0], atol=0.03)
