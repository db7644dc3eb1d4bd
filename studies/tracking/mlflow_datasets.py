"""The data sets of a study as MLflow shows them: digest, columns, number of rows, and where they lie."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from simulation.errors import InputError
from simulation.store.row_set import RowSet
from studies.tracking.quiet_mlflow import Dataset, DatasetInput, InputTag
from studies.tuning.study_spec import StudySpec

_CONTEXTS = {"train": "training", "validation": "validation", "test": "testing"}


def dataset_inputs(spec: StudySpec, *, show: Callable[[Path], str]) -> list[DatasetInput]:
    """Return a study's data sets.

    Args:
        spec: the study.
        show: names a folder as a reader in the project's root would type it.
    """
    inputs = []
    for name, context in _CONTEXTS.items():
        file: Path = getattr(spec, f"{name}_file")
        n = spec.n_train if name == "train" else None
        rows = _rows(file, n)
        source = {"store": show(rows.store), "set": show(file)} if rows else {"set": show(file)}
        columns = [
            {"type": "double", "name": parameter, "required": True}
            for parameter in spec.parameter_space.names
        ]
        columns += [{"type": "double", "name": output, "required": True} for output in spec.output_names]
        profile = (
            {"num_rows": rows.n, "num_failed_rows": rows.n_failed, "time_steps": rows.n_steps} if rows else {}
        )
        dataset = Dataset(
            f"{spec.case_name} {name}" + (f" n={spec.n_train}" if name == "train" else ""),
            spec.digests[name][:32],
            "local",
            json.dumps(source),
            schema=json.dumps({"mlflow_colspec": columns}),
            profile=json.dumps(profile),
        )
        inputs.append(DatasetInput(dataset, [InputTag("mlflow.data.context", context)]))
    return inputs


@dataclass(frozen=True)
class _Rows:
    """What a set holds."""

    store: Path
    n: int
    n_failed: int
    n_steps: int


def _rows(file: Path, n: int | None) -> _Rows | None:
    try:
        found = RowSet.load(file)
        rows = found.read(n)
    except InputError:  # on another machine than the one that simulated
        return None
    return _Rows(found.store, rows.n, int(rows.failed.sum()), len(rows.time))
