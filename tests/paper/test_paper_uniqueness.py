"""Clusters of optima and what a Jacobian determines, where the answer is known."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from paper_study_for_tests import RECORDING, REPOSITORY, study_in

from simulation.case import load_case
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.paper.uniqueness import cluster, optima_correlation, run_uniqueness, uniqueness_rows
from studies.uncertainty.identifiability import identifiability
from studies.uncertainty.noise import independent_samples


@dataclass(frozen=True, eq=False)
class ProductModel:
    """y = a b t + c t^2 + 0 d: a and b act through their product alone, d not at all."""

    time: np.ndarray = field(default_factory=lambda: np.linspace(0.0, 1.0, 60))
    output_names: tuple[str, ...] = ("y",)
    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace(
            tuple(Parameter(name, lower=0.2, upper=5.0, estimate=1.0, scale="log") for name in "abcd")
        )
    )

    def simulate(self, theta):
        a, b, c, _ = (column[:, None] for column in theta.T)
        y = (a * b * self.time + c * self.time**2)[:, :, None]
        return Trajectories(theta, y, self.time, tuple("abcd"), self.output_names, ("",) * len(theta))


def noisy(model, theta, sigma=0.01):
    y = model.simulate(theta[None]).y[0]
    y = y + sigma * np.random.default_rng(1).standard_normal(y.shape)
    return Measurement.on_grid(model.time, y, model.output_names, np.array([0.5]))


def test_a_product_names_its_factors():
    model, theta = ProductModel(), np.array([2.0, 0.7, 1.5, 1.0])
    found = identifiability(model, noisy(model, theta), theta)
    assert found.n_calls == 1 + 2 * 4
    assert found.determined == ("c",)
    assert (found.n_determined_directions, found.n_null_directions) == (2, 2)
    (pair,) = found.pairs
    assert (pair.first, pair.second) == ("a", "b")
    assert pair.strength == pytest.approx(-1.0, abs=1e-6)
    assert "one rises as the other falls" in pair.in_words
    # All that is left open of a and b is how they share the product.
    assert found.correlation[0, 1] < -0.95
    assert found.alignment[0, 1] == pytest.approx(1.0)
    # Nothing is known of d but its box: the deviation of an even distribution.
    assert found.spread[3] == pytest.approx(np.sqrt(1 / 12))


def test_the_spread_of_a_parameter_alone_is_the_textbook_one():
    model, theta = ProductModel(), np.array([2.0, 0.7, 1.5, 1.0])
    measurement = noisy(model, theta)
    found = identifiability(model, measurement, theta)
    # Linear regression on t and t^2, carried to the logarithm and the range of c.
    design = np.column_stack([model.time, model.time**2])
    sigma_c = np.sqrt(np.linalg.inv(design.T @ design)[1, 1]) * found.noise
    assert found.spread[2] == pytest.approx(sigma_c / 1.5 / np.log(25.0), rel=0.01)


def test_on_a_bound_the_difference_is_taken_inwards():
    model, theta = ProductModel(), np.array([5.0, 0.2, 1.5, 1.0])
    found = identifiability(model, noisy(model, theta), theta)
    assert found.on_bound.tolist() == [True, True, False, False]
    assert found.pairs[0].strength == pytest.approx(-1.0, abs=1e-3)


def test_residuals_that_follow_each_other_count_for_less():
    rng = np.random.default_rng(0)
    white = rng.standard_normal(4000)
    assert independent_samples(white) == pytest.approx(4000, rel=0.1)
    slow = np.zeros(4000)
    for i in range(1, 4000):
        slow[i] = 0.9 * slow[i - 1] + white[i]
    # (1 - 0.9) / (1 + 0.9) of them.
    assert independent_samples(slow) == pytest.approx(4000 / 19, rel=0.2)


def test_planted_clusters_are_found_and_numbered_by_size():
    rng = np.random.default_rng(3)
    middles = np.array([[0.1, 0.1, 0.1], [0.9, 0.1, 0.5], [0.5, 0.9, 0.9], [0.2, 0.8, 0.2]])
    planted = np.repeat([0, 1, 2, 3], [10, 40, 25, 5])
    points = middles[planted] + 0.02 * rng.standard_normal((80, 3))
    found = cluster(points, 4, seed=0)
    assert found.sizes.tolist() == [40, 25, 10, 5]
    assert found.centers == pytest.approx(middles[[1, 2, 0, 3]], abs=0.03)
    assert np.array_equal(found.labels, np.array([2, 0, 1, 3])[planted])


def test_there_are_never_more_clusters_than_points():
    assert len(cluster(np.array([[0.0], [0.0], [1.0]]), 10, seed=0).sizes) == 2


def test_a_parameter_that_never_moves_correlates_with_nothing():
    u = np.array([[0.1, 0.5, 0.9], [0.4, 0.5, 0.6], [0.7, 0.5, 0.3]])
    correlation = optima_correlation(u)
    assert correlation[0, 2] == pytest.approx(-1.0)
    assert not correlation[1].any()


def test_uniqueness_of_a_day_of_the_office(tmp_path):
    study = study_in(tmp_path)
    row = uniqueness_rows(n_starts=6)["paper"]
    found = run_uniqueness(study, row, n_clusters=3)
    assert sum(one["size"] for one in found["clusters"]) == 6
    assert found["mse_best"] == found["mse_best_5_percent"] <= found["mse_median"]
    assert found["identifiability"]["mse"] == pytest.approx(found["mse_best"], rel=1e-9)
    # All conductances, capacities and gains may grow together: exactly one direction that changes nothing.
    assert found["identifiability"]["n_null_directions"] == 1
    assert run_uniqueness(study, row, n_clusters=3) == found
    assert run_uniqueness(study, replace(row), n_clusters=2)["n_calls"] == found["n_calls"]


def test_the_recording_names_the_papers_pair(tmp_path):
    if not RECORDING.is_dir():
        pytest.skip("needs the published recording in ../shared/data/office_recording")
    text = (REPOSITORY / "fmus" / "office-recorded" / "case.toml").read_text()
    text = text.replace("../office/Office.fmu", str(REPOSITORY / "fmus" / "office" / "Office.fmu"))
    (tmp_path / "case.toml").write_text(text.replace("../../data/office-recorded", str(RECORDING)))
    case = load_case(tmp_path)
    # Where 256 patient starts of LS-TRF end, one of them: 0.01028 K2.
    walls = {"UWin": 0.14, "rExt1": 0.976305, "rExt2": 0.249987, "cExt1": 37185.0, "fSol": 0.0895232}
    ceiling = {"TTABSInit": 305.998, "cTABS": 446789.0, "rPipe": 0.0665983, "rZone": 0.269902}
    room = {"rInt": 0.479025, "cInt": 450000.0, "b": 10.4193, "VSUP": 0.00222, "qIntOcc": 2.4}
    theta = np.array([(walls | ceiling | room)[name] for name in case.parameter_space.names])
    with case.open_model() as model:
        found = identifiability(model, case.measurement, theta)
    assert {(pair.first, pair.second) for pair in found.pairs} >= {("rExt2", "cExt1")}
    assert all(pair.strength < 0 for pair in found.pairs if pair.first == "rExt2")
    assert found.n_null_directions == 1
    assert found.n_determined_directions < 14
