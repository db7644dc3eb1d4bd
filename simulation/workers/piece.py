"""What an executor's process or thread does: one piece of rows after the other, in a supervised child."""

import hashlib
import os
import pickle
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from simulation.arrays import FloatArray
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.parallel import ParallelModel
from simulation.workers.recipe import Facts, Recipe, packed

# A process keeps this many models open: each may hold a licence.
_KEPT_MODELS: Final = 2
_RECIPE: Final = "recipe"


@dataclass(frozen=True)
class Parcel:
    """A recipe on its way to another process, or to another machine.

    Attributes:
        digest: SHA-256 of the recipe and of the model's file, in hexadecimal.
        recipe: The recipe, pickled; None where it lies in the folder of files, like the model's file.
        file_digest: SHA-256 of the model's file; "" where it is used where it is.
        file_name: Its name.
    """

    digest: str
    recipe: bytes | None
    file_digest: str = ""
    file_name: str = ""

    def unpacked(self, files: Path | None) -> Recipe:
        """Return the recipe, pointed at the file of this machine.

        Args:
            files: Folder of files by their digest; None where files are found where they are.
        """
        if self.recipe is not None or files is None:
            here: Recipe = pickle.loads(self.recipe or b"")
            return here
        there: Any = pickle.loads((files / self.digest / _RECIPE).read_bytes())
        if self.file_digest:
            owner = replace(there.__self__, path=files / self.file_digest / self.file_name)
            there = getattr(owner, there.__name__)
        moved: Recipe = there
        return moved


def parcel(recipe: Recipe) -> Parcel:
    """Pack a recipe for a process that sees the model's file.

    Args:
        recipe: The recipe.
    """
    content = packed(recipe)
    return Parcel(hashlib.sha256(content).hexdigest(), content)


def parcel_with_files(recipe: Recipe) -> tuple[Parcel, dict[tuple[str, str], bytes]]:
    """Pack a recipe for a machine that does not.

    Args:
        recipe: The recipe; the owner of a file has it in its field path, and is a frozen dataclass.

    Returns:
        The parcel, and the files that have to be there by digest and name.
    """
    content = packed(recipe)
    path = getattr(getattr(recipe, "__self__", None), "path", None)
    if not isinstance(path, Path):
        digest = hashlib.sha256(content).hexdigest()
        return Parcel(digest, None), {(digest, _RECIPE): content}
    file = path.read_bytes()
    file_digest = hashlib.sha256(file).hexdigest()
    digest = hashlib.sha256(content + file_digest.encode()).hexdigest()
    files = {(digest, _RECIPE): content, (file_digest, path.name): file}
    return Parcel(digest, None, file_digest, path.name), files


@dataclass(frozen=True)
class PieceAnswer:
    """What became of a piece.

    Attributes:
        y: Outputs. Shape (n, t, k). [per output]
        failures: Why each row failed; "" where it is good.
        spent_s: Time that it took, without opening the model. [s]
    """

    y: FloatArray
    failures: tuple[str, ...]
    spent_s: float


def facts_of(files: Path | None, parcel: Parcel, policy: ExecutionPolicy) -> Facts:
    """Open the model in the supervised child of this process and thread, and say what it looks like.

    Args:
        files: Folder of files by their digest; None where files are found where they are.
        parcel: The model.
        policy: What happens to rows that hang, crash or fail.
    """
    model = _model(files, parcel, policy)
    return Facts(model.parameter_space, model.output_names, model.time)


def simulate_piece(
    files: Path | None, parcel: Parcel, policy: ExecutionPolicy, theta: FloatArray
) -> PieceAnswer:
    """Simulate rows in the supervised child of this process and thread.

    Args:
        files: Folder of files by their digest; None where files are found where they are.
        parcel: The model.
        policy: What happens to rows that hang, crash or fail.
        theta: Parameters. Shape (n, p). [per parameter]
    """
    model = _model(files, parcel, policy)
    began = time.monotonic()
    answer = model.simulate(theta)
    return PieceAnswer(answer.y, answer.failures, time.monotonic() - began)


# The open models of each thread, the last one used at the end.
_KEPT: Final = threading.local()


def _model(files: Path | None, parcel: Parcel, policy: ExecutionPolicy) -> ParallelModel:
    if getattr(_KEPT, "owner", None) != os.getpid():
        _KEPT.owner, _KEPT.models = os.getpid(), OrderedDict()
    models: OrderedDict[Any, ParallelModel] = _KEPT.models
    key = (parcel.digest, policy)
    if key not in models:
        while len(models) >= _KEPT_MODELS:
            models.popitem(last=False)[1].close()
        models[key] = ParallelModel(parcel.unpacked(files), 1, policy=policy)
    models.move_to_end(key)
    return models[key]
