"""Studies without a training: records in the format of real ones, written where real ones lie."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from pelsvae.config import VARIANTS
from studies.paths import ProjectPaths
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import StudyEntry, TrialStore, open_trials

STARTED_S = 1.7e9
DIGESTS = {
    name: digit * 64 for name, digit in zip(("case", "fmu", "validation", "test"), "1245", strict=True)
}
REASONS = {"pruned": "worse than the others", "failed": "ValueError: no", "complete": "max_epochs"}


def write_study(
    root: Path,
    label: str,
    n_train: int,
    *,
    n_trials: int,
    seed: int = 0,
    n_planned: int | None = None,
    case: str = "office",
    **changes: Any,
) -> TrialStore:
    """Write the trials of a study: the first complete, every seventh pruned, every eleventh failed."""
    name = f"{label}/n{n_train:04d}/{seed:04x}{n_train:04x}"
    store = open_trials(ProjectPaths(root), name)
    store.describe(
        StudyEntry(
            name=name,
            label=label,
            case_name=case,
            n_train=n_train,
            n_planned=n_trials if n_planned is None else n_planned,
            n_parallel=1,
            seed=seed,
            variant="refined",
            output_unit="degC",
            digests=changes.get("digests", _digests(n_train)),
            created_s=STARTED_S,
        )
    )
    random = np.random.default_rng((seed, n_train))
    for index in range(n_trials):
        store.write(made_record(label, n_train, index, seed, random, **changes), _curves(random))
    return store


def made_record(
    label: str, n_train: int, index: int, seed: int, random: np.random.Generator, **changes: Any
) -> TrialRecord:
    """Make up a finished trial."""
    state = "pruned" if index % 7 == 5 else "failed" if index % 11 == 9 else "complete"
    value = float(0.2 + random.gamma(4.0) / np.sqrt(n_train))
    metrics = {"val/mae": value, "val/p90": 1.8 * value, "test/mae": 1.1 * value, "test/p90": 2.0 * value}
    config = VARIANTS["refined"].replace(n_latent=int(2 ** random.integers(3, 7)), max_epochs=400)
    values: dict[str, Any] = {
        "study": f"{label}/n{n_train:04d}/{seed:04x}{n_train:04x}",
        "n_train": n_train,
        "index": index,
        "state": state,
        "reason": REASONS[state],
        "params": {"beta": config.beta, "log2_n_latent": int(np.log2(config.n_latent)), "log2_n_hidden": 8},
        "config": config.to_dict(),
        "seed": seed * 1000 + index,
        "started_s": STARTED_S + 60.0 * index,
        "wall_s": 55.0,
        "digests": _digests(n_train),
        "owner": {"host": "somewhere", "pid": 4711, "process_started_s": STARTED_S},
        "metrics": metrics if state == "complete" else {"val/mae": value} if state == "pruned" else {},
        "reports": {str(epoch): value + 10.0 / epoch for epoch in (25, 50, 100, 200, 400)},
        "n_epochs": 400,
        "best_epoch": 380,
        "n_rows": n_train,
    }
    return TrialRecord(**(values | changes))


def _digests(n_train: int) -> dict[str, str]:
    return DIGESTS | {"train": f"{n_train:064x}"}


def _curves(random: np.random.Generator) -> dict[str, Any]:
    epoch = np.arange(20, 401, 20)
    curve = 0.3 + 4.0 / epoch + 0.01 * random.random(len(epoch))
    return {"epoch": epoch, "loss": 10.0 * curve, "validation_mae": curve}


def write_manifest(root: Path, label: str, stage: str, summary: dict[str, Any], **more: Any) -> None:
    """Write what a finished stage leaves."""
    folder = root / "mlruns" / "results" / label
    folder.mkdir(parents=True, exist_ok=True)
    content = {"stage": stage, "digest": "d" * 64, "inputs": {}, "summary": summary, "finished": "", **more}
    (folder / f"{stage}.json").write_text(json.dumps(content), encoding="utf-8")
