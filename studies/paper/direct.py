"""One row of the paper's Table 3, computed: starts side by side in processes, each a line on disk when done.

The starts share no store of simulations: a million rows that nobody asks again are not worth keeping. An
interruption loses the starts at work; differential evolution, a single long start, keeps a journal instead.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.paper.direct_crew import OnStart, Task, compute_starts
from studies.paper.direct_kept import KeptStarts
from studies.paper.direct_optimizers import StartResult, thinned
from studies.paper.direct_row import DirectRow, published_row, start_points
from studies.stages.calibrate import write_arrays
from studies.stages.pipeline import Study, digest_of, read_json, write_json
from studies.tracking.origin import versions


def direct_folder(study: Study) -> Path:
    """Return where the rows and their starts lie."""
    return study.results / "paper" / "direct"


def run_direct_row(study: Study, row: DirectRow, on_start: OnStart | None = None) -> dict[str, Any]:
    """Compute a row, or read it where it is finished; the starts that it shares with others are not repeated.

    Args:
        study: The study: case, window, processes, where results lie.
        row: The row.
        on_start: Told how far it is, after each start.

    Returns:
        The row's numbers; the same as in `<row.name>.json`, with arrays beside it in `<row.name>.npz`.

    Raises:
        InputError: Another command computes these starts right now.
        StageError: The model cannot be run.
    """
    folder = direct_folder(study)
    file = folder / f"{row.name}.json"
    digest = digest_of({"row": asdict(row), **_inputs(study)})
    finished = read_json(file)
    if finished is not None and finished.get("digest") == digest and file.with_suffix(".npz").is_file():
        return finished
    starts = run_starts(study, row, on_start)
    numbers, arrays = _summarize(study, row, starts)
    write_arrays(file.with_suffix(".npz"), arrays)
    numbers = {"digest": digest, **numbers}
    write_json(file, numbers)
    return numbers


def run_starts(study: Study, row: DirectRow, on_start: OnStart | None = None) -> tuple[StartResult, ...]:
    """Compute the starts of a row that no earlier run has finished, and return all of them in their order."""
    folder = direct_folder(study)
    lock = FileLock(folder / f"{row.series}.lock")
    if not lock.try_acquire():
        raise InputError(f"{row.series}: another command computes these starts; wait for it")
    try:
        digest = digest_of(_series_inputs(study, row))
        kept = KeptStarts(folder / f"{row.series}.starts.jsonl", digest)
        missing = [j for j in range(row.n_starts) if j not in kept.starts]
        if missing:
            # Differential evolution is one long start, which may not be lost. Its points are the same for
            # any problem of these bounds, so that the journal's name says whose answers it holds.
            is_long = row.method == "differential-evolution"
            journal = folder / f"{row.series}.{digest[:16]}.journal" if is_long else None
            task = Task(study.case.make_model, study.case.measurement, row, journal)
            theta0 = start_points(study.case.parameter_space, row)

            def tell() -> None:
                if on_start is not None:
                    on_start(sum(j < row.n_starts for j in kept.starts), row.n_starts)

            compute_starts(task, study.n_jobs, kept, missing, theta0, tell)
            for journal in folder.glob(f"{row.series}.*journal"):
                journal.unlink()
        return tuple(kept.starts[j] for j in range(row.n_starts))
    finally:
        lock.release()


def row_over_seeds(
    study: Study,
    rows: Sequence[DirectRow],
    teller: Callable[[DirectRow], OnStart | None] = lambda row: None,
) -> dict[str, Any]:
    """Compute a row with several seeds and say how far they differ.

    Args:
        study: The study.
        rows: The same row, each with its seed.
        teller: Makes what is told how far a row is.

    Returns:
        Quartiles of MSE and calls, and each seed's own numbers.
    """
    found = [run_direct_row(study, row, teller(row)) for row in rows]
    mse, calls = (np.array([one[key] for one in found], dtype=np.float64) for key in ("mse", "n_calls"))
    return {
        "seeds": [row.seed for row in rows],
        "mse": mse.tolist(),
        "n_calls": calls.tolist(),
        "mse_quartiles": np.quantile(mse, [0.25, 0.5, 0.75]).tolist(),
        "n_calls_quartiles": np.quantile(calls, [0.25, 0.5, 0.75]).tolist(),
        "wall_s": float(sum(one["wall_s"] for one in found)),
    }


def row_command(study: Study, row: DirectRow) -> str:
    """Return the command that computes this row alone."""
    return f"studies reproduce-paper {study.command} --only table3 --row {row.name}".replace("  ", " ")


def _inputs(study: Study) -> dict[str, Any]:
    space = study.case.parameter_space
    return {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        "is_log": space.is_log.tolist(),
        "estimates": [parameter.estimate for parameter in space.parameters],
    }


def _series_inputs(study: Study, row: DirectRow) -> dict[str, Any]:
    """Return what decides every start of a series; how many there are does not."""
    return {"row": {**asdict(row), "start": None}, **_inputs(study)}


def _summarize(
    study: Study, row: DirectRow, starts: Sequence[StartResult]
) -> tuple[dict[str, Any], dict[str, Any]]:
    names = study.case.parameter_space.names
    mse = np.array([start.mse for start in starts])
    best = starts[int(np.argmin(mse))]
    published = published_row(row)
    history = joined_history(starts)
    few = np.sort(mse)[: max(1, round(0.05 * len(mse)))]
    numbers = {
        "name": row.name,
        "title": row.title,
        "row": asdict(row),
        "command": row_command(study, row),
        "label": study.label,
        "case_sha256": study.case.digest,
        "measurement_sha256": study.case.measurement.digest,
        "mse": float(best.mse),
        "n_calls": sum(start.n_calls for start in starts),
        "wall_s": round(sum(start.wall_s for start in starts), 3),
        "n_starts": len(starts),
        "best_start": int(np.argmin(mse)),
        "theta": dict(zip(names, best.theta.tolist(), strict=True)),
        "mse_of_the_guess": float(starts[0].mse),
        "mse_median": float(np.median(mse)),
        "mse_mean": float(np.mean(mse)),
        "mse_best_5_percent": float(np.mean(few)),
        "reasons": _tally([start.reason for start in starts]),
        "history": thinned(history).tolist(),
        "paper": None if published is None else asdict(published),
        "versions": versions(),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    arrays = {
        "theta0": np.array([start.theta0 for start in starts]),
        "theta": np.array([start.theta for start in starts]),
        "mse": mse,
        "n_calls": np.array([start.n_calls for start in starts]),
        "wall_s": np.array([start.wall_s for start in starts]),
        "history_calls": history[:, 0].astype(np.int64),
        "history_mse": history[:, 1],
    }
    return numbers, arrays


def joined_history(starts: Sequence[StartResult]) -> FloatArray:
    """Return calls and best MSE of starts that were made one after the other. Shape (h, 2)."""
    paid, best, entries = 0, np.inf, []
    for start in starts:
        for calls, mse in start.history:
            if mse < best:
                best = float(mse)
                entries.append((paid + calls, best))
        paid += start.n_calls
    return np.array([*entries, (paid, best)], dtype=np.float64)


def _tally(words: Sequence[str]) -> dict[str, int]:
    return {word: words.count(word) for word in sorted(set(words), key=lambda w: (-words.count(w), w))}
