"""From a design to trajectories on disk, in chunks that survive any interruption."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from simulation.whole_file import whole_file

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class GenerateResult:
    """Trajectories of a design, and what they cost this time.

    Attributes:
        trajectories: One row per row of the design.
        n_simulated: Rows simulated in this call.
        n_reused: Rows found on disk.
    """

    trajectories: Trajectories
    n_simulated: int
    n_reused: int


def generate(
    model: ForwardModel,
    theta: FloatArray,
    folder: Path,
    *,
    chunk_size: int = 64,
    model_digest: str = "",
    on_progress: Callable[[int, int], None] | None = None,
) -> GenerateResult:
    """Simulate the rows of a design that the folder does not hold yet.

    Chunk i holds the rows from i * chunk_size on and is replaced as a whole, so a process killed at any point
    loses the chunk it works on and nothing else. Nested designs share their chunks: asking for more rows
    later simulates the new ones alone. A damaged chunk is simulated again.

    Args:
        model: The model to ask.
        theta: The design. Shape (n, p). [per parameter]
        folder: Where the chunks lie; one folder per model and design, created when missing.
        chunk_size: Rows per chunk; must stay the same for a folder.
        model_digest: What the model answers with, for instance a case's digest; pinned in the folder.
        on_progress: Called with (rows done, rows in all) at the start and after every chunk.

    Returns:
        The trajectories in the order of the rows, and how many were simulated now.

    Raises:
        InputError: If the folder belongs to another model, another design or another chunk size.
    """
    theta = np.asarray(theta, dtype=np.float64)
    if chunk_size < 1:
        raise ValueError(f"chunk_size is {chunk_size}; a chunk holds at least one row")
    if len(theta) == 0:
        raise ValueError("the design has no rows; ask for at least one")
    folder = Path(folder)
    _pin(folder, _describe(model, chunk_size=chunk_size, model_digest=model_digest))
    starts = range(0, len(theta), chunk_size)
    paths = [folder / f"chunk-{i:05d}.npz" for i in range(len(starts))]
    held = [
        _held_rows(path, theta[start : start + chunk_size]) for path, start in zip(paths, starts, strict=True)
    ]
    n_reused = n_done = sum(part.n for part in held if part is not None)
    if on_progress:
        on_progress(n_done, len(theta))
    chunks = []
    for start, path, found in zip(starts, paths, held, strict=True):
        rows = theta[start : start + chunk_size]
        n_found = found.n if found is not None else 0
        if n_found < len(rows):
            new = model.simulate(rows[n_found:])
            found = new if found is None else Trajectories.concatenate([found, new])
            found.save(path)
            n_done += new.n
            if on_progress:
                on_progress(n_done, len(theta))
        assert found is not None
        chunks.append(found)
    return GenerateResult(Trajectories.concatenate(chunks), n_simulated=n_done - n_reused, n_reused=n_reused)


def _held_rows(path: Path, rows: FloatArray) -> Trajectories | None:
    """Return what a chunk file already holds of the rows, None when nothing usable."""
    if not path.exists():
        return None
    try:
        chunk = Trajectories.load(path)
    except InputError:
        path.unlink()
        return None
    n_shared = min(chunk.n, len(rows))
    if not np.array_equal(chunk.theta[:n_shared], rows[:n_shared], equal_nan=True):
        raise InputError(f"{path}: holds the rows of another design; delete the folder or choose another one")
    return chunk.take(np.arange(n_shared))


def _describe(model: ForwardModel, *, chunk_size: int, model_digest: str) -> dict[str, object]:
    space = model.parameter_space
    return {
        "schema": 1,
        "model_digest": model_digest,
        "parameter_names": list(space.names),
        "lower": space.lower.tolist(),
        "upper": space.upper.tolist(),
        "output_names": list(model.output_names),
        "n_times": len(model.time),
        "time_digest": hashlib.sha256(np.ascontiguousarray(model.time, dtype="<f8").tobytes()).hexdigest(),
        "chunk_size": chunk_size,
    }


def _pin(folder: Path, description: dict[str, object]) -> None:
    """Write the folder's manifest, or check that it is this model's."""
    path = folder / MANIFEST
    if path.exists():
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InputError(
                f"{path}: not a readable manifest; delete the folder, it will be simulated again"
            )
        for key, value in description.items():
            if found.get(key) != value:
                raise InputError(
                    f"{path}: {key} is {found.get(key)!r}, this model has {value!r}; "
                    "delete the folder or choose another one"
                )
        return
    with whole_file(path) as file:
        file.write(json.dumps(description, indent=1).encode())
