"""A mean of surrogates: its shares, its file, and that it is the mean of what its parts predict."""

from pathlib import Path

import numpy as np
import pytest
from rc_step_for_tests import PROCESSES, SMALL, rc_step

from pelsvae.mean_shares import mean_shares
from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.metrics import errors
from pelsvae.surrogate import Surrogate
from pelsvae.surrogate_files import DESCRIPTION, load_surrogate, save_surrogate
from pelsvae.training import fit

ONE = np.ones(2)
WEIGHED = 1.005  # parts that hardly count are left out


@pytest.fixture(scope="module")
def parts() -> list[Surrogate]:
    data, validation = rc_step(24, seed=1, n_outputs=2), rc_step(40, seed=2, n_outputs=2)
    configs = (SMALL, SMALL.replace(n_hidden=12), PROCESSES.replace(n_members=2, max_epochs=2))
    fitted = [fit(*data, validation, config=one, seed=k) for k, one in enumerate(configs)]
    return [one.surrogate for one in fitted]


def test_the_shares_are_those_of_least_absolute_error(parts: list[Surrogate]) -> None:
    theta, y = rc_step(40, seed=2, n_outputs=2)
    share = mean_shares(parts, theta, y, ONE)
    assert share.sum() == pytest.approx(1.0)
    assert (share >= 0.0).all()
    predicted = np.stack([one.predict(theta) for one in parts])

    def error(share: np.ndarray) -> float:
        return float(np.abs(np.tensordot(share, predicted, 1) - y).mean())

    # No other mean is better, be it of one part alone.
    others = np.random.default_rng(0).dirichlet(np.full(3, 0.5), 300)
    least = min(map(error, [*np.eye(3), *others]))
    assert error(share) <= WEIGHED * least


def test_equal_parts_and_perfect_parts_are_no_trouble(parts: list[Surrogate]) -> None:
    theta = rc_step(10, seed=3)[0]
    y = parts[0].predict(theta)
    np.testing.assert_allclose(mean_shares([parts[0], parts[0]], theta, y, ONE).sum(), 1.0)
    np.testing.assert_allclose(mean_shares(parts, theta, y, ONE), [1.0, 0.0, 0.0], atol=1e-6)


def test_a_saved_mean_predicts_the_mean_of_its_parts(parts: list[Surrogate], tmp_path: Path) -> None:
    theta, y = rc_step(7, seed=3, n_outputs=2)
    mean = MeanSurrogate(tuple(parts), (0.5, 0.2, 0.3))
    save_surrogate(mean, tmp_path)
    loaded = load_surrogate(tmp_path, device="cpu")
    predicted = loaded.predict(theta, n_jobs=2)
    np.testing.assert_array_equal(predicted, mean.predict(theta))
    by_hand = sum(s * one.predict(theta) for s, one in zip(mean.shares, parts, strict=True))
    np.testing.assert_allclose(predicted, by_hand, rtol=1e-12)
    assert errors(predicted, y).mae <= max(errors(one.predict(theta), y).mae for one in parts)
    assert loaded.log_columns.tolist() == [0, 1]
    with pytest.raises(ValueError, match="must be positive"):
        loaded.predict(-theta)


@pytest.mark.parametrize(
    ("was", "now"), [("0.5,", "0.9,"), ("0.5,", "-0.5,"), ('"format": 2', '"format": 3'), ('"shares"', '"x"')]
)
def test_a_damaged_description_is_refused_in_one_line(
    parts: list[Surrogate], tmp_path: Path, was: str, now: str
) -> None:
    save_surrogate(MeanSurrogate(tuple(parts[:2]), (0.5, 0.5)), tmp_path)
    file = tmp_path / DESCRIPTION
    text = file.read_text()
    assert was in text
    file.write_text(text.replace(was, now))
    with pytest.raises(ValueError, match="is damaged"):
        load_surrogate(tmp_path)
