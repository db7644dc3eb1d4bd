"""A trained surrogate: predictions, Jacobian, and its two files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rc_step_for_tests import PROCESSES, RESIDUAL, SMALL, rc_step

from pelsvae.config import VARIANTS
from pelsvae.surrogate import Surrogate
from pelsvae.surrogate_files import load_surrogate, save_surrogate
from pelsvae.training import fit

FLOAT32_TOL = 1e-5  # relative to the largest value: float32 sums in another order


@pytest.fixture(scope="module", params=[SMALL, RESIDUAL, PROCESSES], ids=["plain", "residual", "processes"])
def surrogate(request: pytest.FixtureRequest) -> Surrogate:
    validation = rc_step(20, seed=2, n_outputs=2)
    return fit(*rc_step(32, seed=1, n_outputs=2), validation, config=request.param, seed=0).surrogate


def test_prediction_has_physical_shape_and_precision(surrogate: Surrogate) -> None:
    theta, y = rc_step(7, seed=3, n_outputs=2)
    predicted = surrogate.predict(theta)
    assert (predicted.shape, predicted.dtype) == (y.shape, np.float64)
    assert surrogate.predict(theta[:0]).shape == (0, 21, 2)
    np.testing.assert_array_equal(predicted, surrogate.predict(theta))
    # Nor do the cores that share rows change a bit.
    many, _ = rc_step(600, seed=4)
    np.testing.assert_array_equal(surrogate.predict(many, n_jobs=3), surrogate.predict(many))


@given(st.permutations(range(600)))
@settings(max_examples=2, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_rows_are_independent_of_order_and_chunk(surrogate: Surrogate, order: list[int]) -> None:
    theta, _ = rc_step(600, seed=4)
    together = surrogate.predict(theta)
    scale = np.abs(together).max(axis=(0, 1))
    assert (np.abs(surrogate.predict(theta[order]) - together[order]) <= FLOAT32_TOL * scale).all()
    alone = np.concatenate([surrogate.predict(theta[i : i + 1]) for i in order[:5]])
    assert (np.abs(alone - together[order[:5]]) <= FLOAT32_TOL * scale).all()


def test_nan_row_stays_a_nan_row(surrogate: Surrogate) -> None:
    theta, _ = rc_step(4, seed=3)
    theta[1, 0] = np.nan
    predicted = surrogate.predict(theta)
    assert np.isnan(predicted[1]).all()
    assert np.isfinite(predicted[[0, 2, 3]]).all()


def test_wrong_parameters_are_refused(surrogate: Surrogate) -> None:
    with pytest.raises(ValueError, match=r"theta has shape \(3, 5\); this surrogate takes \(n, 2\)"):
        surrogate.predict(np.ones((3, 5)))
    with pytest.raises(ValueError, match=r"theta has shape \(2,\); this surrogate takes \(n, 2\)"):
        surrogate.predict(np.ones(2))
    with pytest.raises(ValueError, match=r"parameter columns \[1\] enter by their logarithm"):
        surrogate.predict([[1.0, 0.0]])


def test_loaded_surrogate_is_the_same_bit_for_bit(surrogate: Surrogate, tmp_path: Path) -> None:
    theta, _ = rc_step(300, seed=5)
    save_surrogate(surrogate, tmp_path / "a" / "n0032")
    moved = (tmp_path / "a").rename(tmp_path / "b") / "n0032"
    loaded = load_surrogate(moved, device="cpu")
    assert sorted(file.name for file in moved.iterdir()) == ["surrogate.json", "weights.npz"]
    with np.load(moved / "weights.npz", allow_pickle=False) as file:
        assert all(file[name].dtype.kind in "fi" for name in file.files)
    assert loaded.config == surrogate.config
    np.testing.assert_array_equal(loaded.predict(theta), surrogate.predict(theta))
    save_surrogate(loaded, tmp_path / "c")
    for name in ("surrogate.json", "weights.npz"):
        assert (tmp_path / "c" / name).read_bytes() == (moved / name).read_bytes()


@pytest.mark.parametrize("missing", ["weights.npz", "surrogate.json"])
def test_missing_file_is_named(surrogate: Surrogate, tmp_path: Path, missing: str) -> None:
    save_surrogate(surrogate, tmp_path)
    (tmp_path / missing).unlink()
    with pytest.raises(FileNotFoundError, match=f"{missing} is missing"):
        load_surrogate(tmp_path)


def edited(folder: Path, **changes: object) -> None:
    path = folder / "surrogate.json"
    known = json.loads(path.read_text())
    del known["checksum"]
    path.write_text(json.dumps({**known, **changes}))


def test_damaged_weights_are_refused(surrogate: Surrogate, tmp_path: Path) -> None:
    save_surrogate(surrogate, tmp_path)
    weights = tmp_path / "weights.npz"
    cut = weights.read_bytes()[:-100]
    weights.write_bytes(cut)
    with pytest.raises(ValueError, match=r"weights.npz is damaged or not the one"):
        load_surrogate(tmp_path)
    edited(tmp_path, weights_sha256=hashlib.sha256(cut).hexdigest())
    with pytest.raises(ValueError, match=r"weights.npz does not fit surrogate.json"):
        load_surrogate(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 99}, r"surrogate.json is damaged"),
        ({"config": {"n_latnet": 4}}, r"surrogate.json is damaged"),
        ({"config": {}}, r"does not fit surrogate.json"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(
    surrogate: Surrogate, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    save_surrogate(surrogate, tmp_path)
    edited(tmp_path, **changes)
    with pytest.raises(ValueError, match=message):
        load_surrogate(tmp_path)


@pytest.mark.parametrize("n_more", [5, 7, 11])
def test_threads_that_share_the_rows_change_no_bit(n_more: int) -> None:
    rng = np.random.default_rng(0)
    theta, y = rng.uniform(1.0, 2.0, (32, 14)), rng.normal(size=(32, 50, 1))
    config = VARIANTS["refined"].replace(max_epochs=2, n_hidden=74, n_threads=1)
    surrogate = fit(theta, y, (theta, y), config=config, seed=0).surrogate
    # The last thread has few rows: with two threads of its own, linear algebra gave them other digits.
    many = rng.uniform(1.0, 2.0, (surrogate.network.rows_at_once + n_more, 14))
    np.testing.assert_array_equal(surrogate.predict(many, n_jobs=2), surrogate.predict(many))
