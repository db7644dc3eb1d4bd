"""Studies without a training: trials added to Optuna, and calibrations, where real ones lie."""

import tomllib
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

from pelsvae.config import VARIANTS
from simulation.record_file import write_json
from studies.calibration.ledger import Ledger
from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.results.saved import arrays_of, plain, write_arrays
from studies.results.stage_results import Calibration
from studies.tuning.attempts import DECLARATION, PLANNED, RUN_ID
from studies.tuning.storage import open_storage

MAX_EPOCHS = 400
WALL_S = 60.0
SPACE = {
    "n_latent": IntDistribution(8, 128, log=True),
    "n_hidden": IntDistribution(64, 256, log=True),
    "beta": FloatDistribution(1.0, 1000.0, log=True),
}
SEARCH = {
    name: {"kind": kind, "low": one.low, "high": one.high, "log": True}
    for (name, one), kind in zip(SPACE.items(), ("int", "int", "float"), strict=True)
}
DIGESTS = {
    name: digit * 64 for name, digit in zip(("case", "fmu", "validation", "test"), "1245", strict=True)
}


def declared(label: str, n_train: int, **changes: Any) -> Declaration:
    """Declare a study; anything of it may be changed by name."""
    variant = VARIANTS["refined"].replace(max_epochs=MAX_EPOCHS)
    settings = {k: v for k, v in variant.to_dict().items() if k not in ("device", "n_threads")}
    values: dict[str, Any] = {
        "label": label,
        "n_train": n_train,
        "case_name": "office",
        "surrogate": "refined",
        "settings": settings,
        "search": SEARCH,
        "sampler": {"name": "TPESampler"},
        "pruner": {"name": "CatchUpPruner"},
        "seed": 0,
        "parameter_names": ("UWin",),
        "lower": (0.1,),
        "upper": (1.0,),
        "is_log": (True,),
        "output_names": ("TAir",),
        "output_unit": "degC",
        "output_scales": (1.0,),
        "files": {name: f"data/office/{name}.npz" for name in ("train", "validation", "test")},
        "digests": DIGESTS | {"train": f"{n_train:064x}"},
    }
    return Declaration(**(values | changes))


def declared_baseline(label: str, n_train: int, **changes: Any) -> Declaration:
    """Declare the PCA + GP beside a study."""
    return declared(label, n_train, surrogate="pca-gp", search={}, is_baseline=True, **changes)


def write_study(
    root: Path,
    spec: Declaration,
    *,
    n_trials: int,
    n_planned: int | None = None,
    clock: timedelta = timedelta(),
) -> optuna.Study:
    """Add the trials of a study to Optuna: the first complete, every sixth pruned, every tenth failed.

    The machine's clock is ahead by `clock`.
    """
    study = optuna.create_study(storage=open_storage(ProjectPaths(root)), study_name=spec.name)
    study.set_user_attr(DECLARATION, spec.to_dict())
    study.set_user_attr(PLANNED, n_trials if n_planned is None else n_planned)
    random = np.random.default_rng((spec.seed, spec.n_train))
    for index in range(n_trials):
        error = float(0.2 + random.gamma(4.0) / np.sqrt(spec.n_train))
        trial = ended_trial(spec, index, error, n_latent=int(2 ** random.integers(3, 7)))
        assert trial.datetime_start is not None
        trial.datetime_start += clock
        study.add_trial(trial)
    return study


def ended_trial(spec: Declaration, index: int, error: float, *, n_latent: int = 64) -> FrozenTrial:
    """Make up a trial that has ended."""
    states = {5: TrialState.PRUNED, 9: TrialState.FAIL}
    state = states.get(index % 12, TrialState.COMPLETE)
    others = {"val/p90": 1.8 * error, "test/mae": 1.1 * error, "test/p90": 2.0 * error}
    return optuna.create_trial(
        state=state,
        value=error if state == TrialState.COMPLETE else None,
        params={"n_latent": n_latent, "n_hidden": 128, "beta": 100.0} if spec.search else {},
        distributions=SPACE if spec.search else {},
        intermediate_values={epoch: error + 10.0 / epoch for epoch in (25, 100, MAX_EPOCHS)},
        user_attrs={
            RUN_ID: f"{index:032x}",
            "proposed_by": "default" if index == 0 else "TPESampler" if index > 5 else "start-up",
            "training": {"wall_s": WALL_S, "n_epochs": MAX_EPOCHS},
            **(others if state == TrialState.COMPLETE else {"reason": "made up"}),
        },
    )


def write_calibration(
    root: Path, label: str, name: str, *, case: Path, mse: float, finished: str = "2026-01-01", **changes: Any
) -> None:
    """Write what a finished calibration leaves; anything of its result may be changed by name."""
    folder = root / "mlruns" / "results" / label
    folder.mkdir(parents=True, exist_ok=True)
    declared = tomllib.loads(case.read_text(encoding="utf-8"))
    values: dict[str, Any] = {
        "case": declared["name"],
        "method": "adaptive" if name == "adaptive" else "paper",
        "n_train": 0 if name == "adaptive" else int(name[1:]),
        "seed": 0,
        "settings": {},
        "theta": {},
        "units": {one["name"]: one.get("unit", "1") for one in declared["parameters"]},
        "output_unit": declared["outputs"][0]["unit"],
        "mse": mse,
        "stop_reason": "made up",
        "converged": True,
        "outputs": {},
        "ledger": Ledger(n_adaptive=20).to_dict(),
        "n_failed": 0,
        "first_failure": None,
        "n_simulated": 0,
        **dict.fromkeys(("time", "y", "history_calls", "history_mse"), np.zeros(1)),
    }
    calibration = Calibration(**(values | changes))
    manifest = {"digest": "d" * 64, "wall_s": 1.0, "finished": finished, "result": plain(calibration)}
    manifest["inputs"] = {"case": f"{label}", "measurement": "2"}
    files = {f"fmus/{case.parent.name}/case.toml": "1" * 64}
    write_json(folder / f"calibrate-{name}.json", manifest | {"provenance": {"files": files}})
    write_arrays(folder / f"calibrate-{name}.npz", arrays_of(calibration))
