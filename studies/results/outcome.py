"""What a stage came to, and the files that hold it."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from simulation.errors import InputError
from simulation.record_file import read_json
from studies.paths import ProjectPaths
from studies.results.saved import Arrays, plain, read_arrays, rebuilt

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Outcome(Generic[T]):
    """What a stage came to, and what made it.

    Args:
        stage: name of the stage.
        result: its result.
        digest: digest of its inputs.
        inputs: all that decided the result, as JSON values.
        reused: whether it was finished before.
        wall_s: how long it took, this time or before. [s]
        finished: when it was finished, UTC.
        provenance: what makes the result again, as JSON values; empty where nothing does.
        file: its JSON file; None where another program keeps the result.
    """

    stage: str
    result: T
    digest: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    reused: bool = False
    wall_s: float = 0.0
    finished: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    file: Path | None = None

    @property
    def name(self) -> str:
        """Name of a calibration, of which there are several: "adaptive" or "n0064"."""
        return self.stage.partition("-")[2]

    def to_dict(self, paths: ProjectPaths) -> dict[str, Any]:
        """Return the outcome as JSON values; places in it are relative to the project's folder."""
        head = {"stage": self.stage, "digest": self.digest, "finished_before": self.reused}
        file = {} if self.file is None else {"file": paths.show(self.file)}
        return {**head, "wall_s": round(self.wall_s, 3), **plain(self.result), **file}


def digest_of(inputs: Mapping[str, Any]) -> str:
    """Return the sha256 of JSON values; the order of keys does not matter."""
    text = json.dumps(inputs, sort_keys=True, allow_nan=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def read_manifest(folder: Path, stage: str) -> dict[str, Any] | None:
    """Return what a stage has left, as JSON values; None where there is nothing.

    Raises:
        InputError: it is damaged.
    """
    return read_json(folder / f"{stage}.json", _remedy(stage))


def _remedy(stage: str) -> str:
    """Return what to do where a file of a stage is damaged: its command is the first part of its name."""
    return f"remove {stage}.json, and studies {stage.partition('-')[0]} makes it anew"


def read_outcome(folder: Path, stage: str, kind: type[T]) -> Outcome[T] | None:
    """Read what a finished stage has left; None where there is nothing.

    Args:
        folder: the results of a label.
        stage: name of the stage.
        kind: type of its result.

    Raises:
        InputError: it cannot be read by this version, or its arrays are damaged.
    """
    file = folder / f"{stage}.json"
    manifest, arrays, kept = read_manifest(folder, stage), file.with_suffix(".npz"), Arrays()
    while manifest is not None:
        kept = read_arrays(arrays, _remedy(stage)) if arrays.is_file() else {}
        # Another command may have replaced both meanwhile.
        before, manifest = manifest, read_manifest(folder, stage)
        if repr(manifest) == repr(before):  # NaN is NaN
            break
    if manifest is None or "result" not in manifest:  # which an earlier version wrote
        return None
    result = rebuilt(kind, manifest["result"], str(file), kept)
    try:
        return Outcome(
            stage=stage,
            result=result,
            digest=str(manifest["digest"]),
            inputs=dict(manifest["inputs"]),
            reused=True,
            wall_s=float(manifest["wall_s"]),
            finished=str(manifest["finished"]),
            provenance=dict(manifest.get("provenance", {})),
            file=file,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file}: not written by this version ({error!r}); move it away") from None
