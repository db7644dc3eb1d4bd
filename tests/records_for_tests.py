"""Synthetic records of the shape that real studies have: an office of fourteen parameters, ten days."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from measurement_for_tests import with_each

from simulation.case import Case, KnownError, load_case
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.ledger import Ledger
from studies.calibration.sobol import SobolIndices
from studies.calibration.uncertainty.noise import Noise
from studies.reporting.figures_model import TrialsRecord
from studies.reporting.page import ReportData
from studies.results.outcome import Outcome
from studies.results.stage_results import (
    Calibration,
    Cost,
    Covered,
    Fit,
    Known,
    SampleFound,
    Screened,
    TunedSize,
    Uncertainty,
)

NAMES = ("UWin", "TTABSInit", "rInt", "cInt", "b", "rExt1", "rExt2",
         "cExt1", "cTABS", "rPipe", "rZone", "VSUP", "fSol", "qIntOcc")  # fmt: skip
UNITS = ("W/(m2.K)", "K", "m2.K/W", "J/(m2.K)", "1", "m2.K/W", "m2.K/W",
         "J/(m2.K)", "J/(m2.K)", "m2.K/W", "m2.K/W", "m3/s", "m2", "W/m2")  # fmt: skip
N_POLISH = 124
ESTIMATE = np.array([0.7, 301.15, 0.18, 182e3, 5, 1.06, 0.05, 8500, 7e5, 0.122, 0.183, 0.0111, 0.1, 12])


def time_axis() -> np.ndarray:
    return np.arange(480) * 1800.0


OUTPUTS = ("TAir", "TWall", "TSlab")
REFERENCES = (KnownError("best known", 0.0103, is_target=False), KnownError("target", 0.0125, is_target=True))


@cache
def office() -> Case:
    """Return the embedded office."""
    return load_case(Path(__file__).resolve().parents[1] / "fmus" / "office")


def case(n_outputs: int = 1) -> Case:
    """Return the office with made-up outputs."""
    measurement = measured(n_outputs)
    unit = office().outputs[0].unit
    return replace(
        office(), title="Office room, virtual measurement", references=REFERENCES,
        note="A virtual measurement: a white-box office was simulated, no building was measured.",
        parameter_space=parameter_box(),
        measurement=with_each(measurement, unit=unit),
    )  # fmt: skip


def measured(n_outputs: int = 1) -> Measurement:
    time = time_axis()
    days = time / 86400.0
    y = np.stack(
        [
            21.5 + 0.6 * np.sin(2 * np.pi * days) + 0.25 * np.cos(0.9 * days) + 1.5 * k
            for k in range(n_outputs)
        ],
        1,
    )
    y += np.random.default_rng(1).normal(0, 0.04, y.shape)
    return Measurement.on_grid(time, y, OUTPUTS[:n_outputs], np.full(n_outputs, 0.5))


def parameter_box() -> ParameterSpace:
    lower, upper = ESTIMATE / 5, ESTIMATE * 5
    lower[1], upper[1] = 293.15, 306.15
    return ParameterSpace(
        tuple(
            Parameter(NAMES[j], lower[j], upper[j], ESTIMATE[j], UNITS[j], "linear" if j == 1 else "log")
            for j in range(len(NAMES))
        )
    )


def outcome(found: Calibration) -> Outcome[Calibration]:
    """Return a calibration as its stage leaves it."""
    name = "adaptive" if found.is_adaptive else f"n{found.n_train:04d}"
    return Outcome(f"calibrate-{name}", found, "0" * 64, wall_s=31.7)


def calibration(n_train: int = 64, *, n_outputs: int = 1) -> Calibration:
    measurement, parameters = measured(n_outputs), parameter_box()
    rng = np.random.default_rng(n_train)
    days = measurement.time[:, None] / 86400.0
    y_screened = measurement.y + 0.8 * np.cos(1.3 * days + 1) * np.exp(-n_train / 300) + 0.1
    y_polished = measurement.y + 0.1 * np.sin(5 * days) + rng.normal(0, 0.04, measurement.y.shape)
    mse_screened = float(np.mean((y_screened - measurement.y) ** 2))
    mse_polished = float(np.mean((y_polished - measurement.y) ** 2))
    steps = np.arange(n_train + 1, n_train + 2 + N_POLISH)
    progress = np.clip((steps - steps[0]) // 15 / (N_POLISH / 15), 0, 1) ** 0.4
    history = np.exp((1 - progress) * np.log(mse_screened) + progress * np.log(mse_polished))
    span = parameters.upper - parameters.lower
    theta = parameters.lower + span * rng.uniform(0, 1, 14)
    polished = theta.copy()
    polished[3], polished[5] = parameters.upper[3], parameters.lower[5]
    errors = {"test/mae": 6.0 / n_train**0.5, "test/p90": 11.0 / n_train**0.5}
    screening = Screened(named(theta), 0.0121 + 1e-5 * n_train, mse_screened, "small", errors=errors)
    ledger = Ledger(n_train=n_train, n_validation=320, n_test=320, n_screen_checks=1, n_polish=N_POLISH)
    return Calibration(
        case="office", method="paper", n_train=n_train, seed=0, settings={}, theta=named(polished),
        units=dict(zip(NAMES, UNITS, strict=True)), output_unit="degC", mse=mse_polished, converged=True,
        stop_reason="the cost changes by less than ftol", ledger=ledger.to_dict(), n_failed=0,
        outputs={name: Fit(0.1, 0.5, 0.9) for name in OUTPUTS[:n_outputs]}, first_failure=None,
        n_simulated=0, time=measurement.time, y=y_polished, y_screened=y_screened, history_calls=steps,
        history_mse=history, screening=screening,
    )  # fmt: skip


def named(theta: np.ndarray) -> dict[str, float]:
    return dict(zip(NAMES, theta.tolist(), strict=True))


def adaptive(*, n_outputs: int = 1) -> Calibration:
    """Return an adaptive calibration: no training set, no screened point."""
    other = calibration(64, n_outputs=n_outputs)
    calls = np.concatenate([[14], np.arange(15, 72)])
    return replace(
        other, method="adaptive", n_train=0, screening=None, y_screened=None, history_calls=calls,
        history_mse=np.geomspace(0.08, other.mse, len(calls)), ledger=Ledger(n_adaptive=71).to_dict(),
    )  # fmt: skip


def uncertainty() -> Uncertainty:
    """Return how sure the adaptive calibration is."""
    box, rng = parameter_box(), np.random.default_rng(5)
    p, t = len(NAMES), len(time_axis())
    low, high = box.lower + 0.3 * (box.upper - box.lower), box.lower + 0.6 * (box.upper - box.lower)
    band = 21.5 + np.stack([-0.2 * np.ones((t, 1)), 0.2 * np.ones((t, 1))])
    known = {
        name: Known(0.5 * (a + b), (a, b), (a, b), 0.5 * (a + b), "narrowed")
        for name, a, b in zip(NAMES, low.tolist(), high.tolist(), strict=True)
    }
    return Uncertainty(
        calibration="adaptive", seed=0, max_calls=100, mse=0.01, level=0.9, noise=Noise("white", 0.1, t, t),
        sensor=0.5, has_prior=False, parameters=known, pairs=(), null_directions=(),
        sample=SampleFound(20, 20.0, True, 0.01, {}), outputs={"TAir": Covered(0.5, 0.9)},
        ledger=Cost(2 * p, 2, 20, 2 * p + 22, 14, False), n_failed=0, first_failure=None, n_simulated=0,
        time=time_axis(), sample_theta=rng.uniform(low, high, (20, p)), weights=np.full(20, 0.05),
        particles_theta=rng.uniform(low, high, (200, p)), simulated=band,
        predictive=np.stack([band[0] - 0.5, band[1] + 0.5]),
    )  # fmt: skip


def coverage(n: int = 64, *, n_outputs: int = 1) -> np.ndarray:
    """Return trajectories of a training set. Shape (n, t, k)."""
    rng = np.random.default_rng(2)
    days = time_axis()[None, :, None] / 86400.0
    level, swing, drift = (
        rng.uniform(14, 30, (n, 1, 1)),
        rng.uniform(0.1, 2, (n, 1, 1)),
        rng.normal(0, 1, (n, 1, 1)),
    )
    y = (
        21.5
        + (level - 21.5) * (1 - np.exp(-days / 2))
        + swing * np.sin(2 * np.pi * days)
        + 0.2 * drift * days
    )
    return np.repeat(y, n_outputs, axis=2)


def sensitivity(p: int = 14, *, n_outputs: int = 1, n_undefined: int = 1) -> SobolIndices:
    rng = np.random.default_rng(3)
    days = time_axis()[:, None, None] / 86400.0
    weight = np.exp(-0.42 * np.arange(p)) * rng.uniform(0.7, 1.3, p)
    first = weight * (
        1.2 + 0.4 * np.sin(2 * np.pi * days + np.arange(p)) + 0.1 * np.arange(n_outputs)[:, None]
    )
    first = first * np.exp(-0.05 * days * (np.arange(p) % 3 == 1))
    first = 0.86 * first / first.sum(axis=2, keepdims=True)
    first[:n_undefined] = np.nan
    total = first * 1.2 + 0.01
    ci = np.full_like(first, 0.012) + 0.05 * first
    return SobolIndices(
        time_axis(), NAMES[:p], OUTPUTS[:n_outputs], first, total, ci, ci,
        np.ones(first.shape[:2]), n_base=1024, n_dropped=0, n_calls=16_384,
    )  # fmt: skip


def trials(sizes: tuple[int, ...] = (32, 64, 128, 256, 512, 1024), n_each: int = 12) -> TrialsRecord:
    rng = np.random.default_rng(4)
    n_train = np.repeat(np.array(sizes, dtype=np.int64), n_each)
    validation = 6.0 / n_train**0.5 * np.exp(rng.gamma(1.2, 0.25, len(n_train)))
    test, p90 = (
        validation * rng.uniform(0.95, 1.05, len(n_train)),
        validation * rng.uniform(1.7, 2.1, len(n_train)),
    )
    state = np.array(["complete"] * len(n_train), dtype=object)
    state[4::n_each] = "pruned"
    state[7::n_each] = "pruned"
    if n_each > 2:
        state[2 :: 3 * n_each] = "failed"
    is_best = np.zeros(len(n_train), dtype=bool)
    test[state != "complete"] = np.nan
    p90[state != "complete"] = np.nan
    validation[state == "failed"] = np.nan
    for size in sizes:
        rows = np.flatnonzero((n_train == size) & (state == "complete"))
        is_best[rows[np.argmin(validation[rows])]] = True
    return TrialsRecord(n_train, tuple(str(s) for s in state), validation, test, p90, is_best)


def tuned(every: TrialsRecord) -> tuple[TunedSize, ...]:
    """Return the best of the trials of each size, with made-up hyperparameters and a PCA + GP beside it."""
    found = []
    for k, row in enumerate(np.flatnonzero(every.is_best)):
        n_train = int(every.n_train[row])
        states = [s for s, n in zip(every.state, every.n_train, strict=True) if n == n_train]
        found.append(
            TunedSize(
                label="office-quick", case="office", n_train=n_train, study=f"office-quick/n{n_train}",
                surrogate="refined", is_baseline=False, unit="K", n_planned=len(states),
                n_trials=len(states), n_complete=states.count("complete"), n_pruned=states.count("pruned"),
                n_failed=states.count("failed"), n_running=0, n_waiting=0, n_proposed=0, wall_s=60.0,
                to_go_s=0.0, gain=0.1 * k if k else None, trial=0, run_id="0" * 32, model_uri="models:/a@b",
                params={"n_latent": 8 * 2**k, "n_hidden": 128, "beta": 12.5 * 3**k},
                mae=float(every.test_mae[row]), p90=float(every.test_p90[row]),
                metrics={"val/mae": float(every.validation_mae[row])},
                baseline={"test/mae": 0.9 * float(every.test_mae[row])},
            )
        )  # fmt: skip
    return tuple(found)


def report_data(*calibrations: Calibration, **changes: object) -> ReportData:
    """Return a whole report, of three calibrations by the paper's method unless others are given."""
    found = calibrations or tuple(calibration(n) for n in (32, 64, 256))
    fields: dict[str, object] = {
        "label": "office-quick",
        "case": case(),
        "calibrations": tuple(map(outcome, found)),
        "coverage": coverage(),
        "sensitivity": sensitivity(),
        "trials": trials(),
        "tuned": tuned(trials()),
        "commands": ("studies run office --profile quick", "studies calibrate office --n-train 64"),
    }
    return ReportData(**{**fields, **changes})  # type: ignore[arg-type]
