"""`fit`: it learns, stops, restores, repeats, and refuses what cannot be trained."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from rc_step_for_tests import SMALL, rc_step, step_drive

from pelsvae.config import VARIANTS, SurrogateConfig
from pelsvae.epochs import EpochReport, StopTraining, TrainingDiverged
from pelsvae.metrics import errors
from pelsvae.training import FitResult, fit

TERMS = ("kl", "reconstruction", "regression_mean", "regression_scale")
FLOAT32_TOL = 1e-5  # relative; the same float32 sums, with denormals kept or flushed


def trained(
    seed: int = 0,
    n: int = 24,
    n_outputs: int = 1,
    on_epoch: Callable[[EpochReport], None] | None = None,
    **changes: object,
) -> FitResult:
    theta, y = rc_step(n, seed=1, n_outputs=n_outputs)
    config = SurrogateConfig.from_dict({**SMALL.to_dict(), **changes})
    validation = rc_step(20, seed=2, n_outputs=n_outputs)
    return fit(theta, y, validation, config=config, seed=seed, on_epoch=on_epoch)


@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_each_variant_learns_the_step_response(variant: str) -> None:
    theta, y = rc_step(64, seed=1)
    test_theta, test_y = rc_step(50, seed=3)
    config = VARIANTS[variant]
    small = {"n_hidden": 32, "n_latent": 8, "max_epochs": min(400, config.max_epochs)}
    config = config.replace(**small, device="cpu", n_threads=1)
    result = fit(theta, y, rc_step(20, seed=2), config=config, seed=0, drive=step_drive())
    mae = errors(result.surrogate.predict(test_theta), test_y).mae
    mae_of_the_mean = np.abs(test_y - y.mean(axis=0)).mean()
    assert mae < 0.25 * mae_of_the_mean


def test_same_seed_same_numbers_and_other_seed_others() -> None:
    theta, _ = rc_step(5, seed=9)
    first, again, other = (trained(seed).surrogate.predict(theta) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.0


def test_every_validated_epoch_is_reported_once() -> None:
    reports: list[EpochReport] = []
    theta, y = rc_step(24, seed=1)
    config = SMALL.replace(max_epochs=12)
    fit(theta, y, rc_step(20, seed=2), config=config, seed=0, on_epoch=reports.append)
    assert [(r.epoch, r.max_epochs) for r in reports] == [(5, 12), (10, 12), (12, 12)]
    for report in reports:
        kl, reconstruction, *regressions = (report.terms[name] for name in TERMS)
        total = kl + config.beta * reconstruction + sum(regressions)
        assert report.train_loss == pytest.approx(total, rel=FLOAT32_TOL)


def test_early_stopping_restores_the_best_weights() -> None:
    reports: list[EpochReport] = []
    # A learning rate that wanders: the last weights are not the best.
    result = trained(
        on_epoch=reports.append, learning_rate=0.1, max_epochs=2000, patience=40, validate_every=1
    )
    validation = [report.validation_mae for report in reports]
    assert result.stop_reason == "patience"
    assert result.n_epochs - result.best_epoch == 40
    assert result.best_epoch == 1 + int(np.argmin(validation))
    theta, y = rc_step(20, seed=2)
    restored = errors(result.surrogate.predict(theta), y).mae
    assert restored == pytest.approx(min(validation), rel=FLOAT32_TOL)
    assert restored < validation[-1]


@pytest.mark.parametrize("decoder", ["layers", "state-space"])
def test_a_caller_who_stops_a_training_gets_its_best_weights_so_far(decoder: str) -> None:
    reports: list[EpochReport] = []

    def stop(report: EpochReport) -> None:
        reports.append(report)
        if report.epoch >= 10:
            raise StopTraining("enough")

    theta, y = rc_step(24, seed=1)
    variant = VARIANTS["state-space"] if decoder == "state-space" else SMALL
    config = variant.replace(max_epochs=200, validate_every=5, device="cpu", n_threads=1)
    validation = rc_step(20, seed=2)
    result = fit(theta, y, validation, config=config, seed=0, drive=step_drive(), on_epoch=stop)
    assert (result.stop_reason, result.n_epochs, len(reports)) == ("enough", 10, 2)
    least = min(reports, key=lambda report: report.validation_mae)
    assert result.best_epoch == least.epoch
    mae = errors(result.surrogate.predict(validation[0]), validation[1]).mae
    assert mae == pytest.approx(least.validation_mae, rel=FLOAT32_TOL)


def test_divergence_is_its_own_exception() -> None:
    with pytest.raises(TrainingDiverged, match="lower learning_rate"):
        trained(learning_rate=1e20)


def test_several_outputs_of_different_size_are_learned_alike() -> None:
    result = trained(n=64, n_outputs=2, max_epochs=300, n_hidden=32)
    theta, y = rc_step(50, seed=3, n_outputs=2)
    predicted = result.surrogate.predict(theta)
    assert predicted.shape == y.shape
    scale = np.abs(y - y.mean(axis=0)).mean(axis=(0, 1))
    assert (np.abs(predicted - y).mean(axis=(0, 1)) < 0.25 * scale).all()


def test_logarithms_are_taken_where_values_allow() -> None:
    theta, y = rc_step(24, seed=1)
    theta = np.column_stack([theta, np.linspace(-1.0, 1.0, 24)])
    free = fit(theta, y, (theta, y), config=SMALL.replace(max_epochs=5), seed=0)
    assert free.surrogate.theta_standardizer.log_columns.tolist() == [0, 1]
    chosen = fit(
        theta, y, (theta, y), config=SMALL.replace(max_epochs=5), seed=0, log_columns=[False, True, False]
    )
    assert chosen.surrogate.theta_standardizer.log_columns.tolist() == [1]
    with pytest.raises(ValueError, match=r"parameter columns \[2\] enter by their logarithm"):
        fit(theta, y, (theta, y), config=SMALL, seed=0, log_columns=[False, True, True])
    with pytest.raises(ValueError, match="log_columns must be 3 booleans"):
        fit(theta, y, (theta, y), config=SMALL, seed=0, log_columns=[True, True])


def test_shapes_that_do_not_fit_are_named() -> None:
    theta, y = rc_step(24, seed=1)
    with pytest.raises(ValueError, match=r"training needs theta \(n, p\) and y \(n, t, k\)"):
        fit(theta, y[:, :, 0], (theta, y), config=SMALL, seed=0)
    with pytest.raises(ValueError, match="training needs theta"):
        fit(theta[:5], y, (theta, y), config=SMALL, seed=0)
    with pytest.raises(ValueError, match="validation needs theta"):
        fit(theta, y, (theta[:0], y[:0]), config=SMALL, seed=0)
    with pytest.raises(ValueError, match="do not go with training's"):
        fit(theta, y, (theta, y[:, :-1]), config=SMALL, seed=0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine")
def test_cuda_trains_and_predicts_like_the_cpu() -> None:
    cpu, cuda = trained(max_epochs=5), trained(max_epochs=5, device="cuda")
    theta, y = rc_step(50, seed=3)
    assert cuda.surrogate.eps.is_cuda
    weights = [dict(r.surrogate.network.named_parameters()) for r in (cpu, cuda)]
    assert {n: w.shape for n, w in weights[0].items()} == {n: w.shape for n, w in weights[1].items()}
    assert errors(cuda.surrogate.predict(theta), y).mae < np.abs(y - y.mean(axis=0)).mean()


def test_a_training_loads_neither_torchs_compiler_nor_sympy(tmp_path: Path) -> None:
    script = f"""
import sys
from collections.abc import Callable
import numpy as np
from pelsvae.config import VARIANTS
from pathlib import Path
from pelsvae.surrogate_files import load_surrogate, save_surrogate
from pelsvae.training import fit
rows = np.linspace(1.0, 2.0, 8)[:, None], np.ones((8, 3, 1)) * np.linspace(0.0, 1.0, 8)[:, None, None]
for variant in ("paper", "refined"):
    config, folder = VARIANTS[variant].replace(max_epochs=2, device="cpu"), Path({str(tmp_path)!r}) / variant
    folder.mkdir()
    save_surrogate(fit(*rows, rows, config=config, seed=0).surrogate, folder)
    load_surrogate(folder).predict(rows[0])
assert not {{"torch._dynamo", "sympy"}} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", script], check=True)
